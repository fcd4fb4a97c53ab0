# bgs-bench with gsplat on NVIDIA GPUs; nvcc stays in the image, since gsplat builds its kernels when it is first used:
#   docker build -f docker/cuda.Dockerfile -t bgs-bench:cuda .
#   docker run --rm --gpus all -v "$PWD/results:/bench/results" bgs-bench:cuda run mapper.rasterizer=gsplat
FROM nvidia/cuda:12.8.1-devel-ubuntu24.04
RUN apt-get update && apt-get install -y --no-install-recommends g++ make git ninja-build python3 python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/* && useradd --create-home bench && mkdir /bench && chown bench /bench
WORKDIR /source
COPY . .
# gsplat wants a torch for the CUDA of the image; those of 2.8 and 2.9 are for 12.8. No constraints: they were tested with a torch
# for CPUs.
RUN python3 -m venv /opt/bgs-bench && /opt/bgs-bench/bin/pip install --no-cache-dir 'torch>=2.8,<2.10' '.[cuda]'
ENV PATH=/opt/bgs-bench/bin:$PATH TORCH_EXTENSIONS_DIR=/home/bench/.cache/torch_extensions
USER bench
WORKDIR /bench
RUN bgs-bench weights get alexnet
ENTRYPOINT ["bgs-bench"]
CMD ["--help"]
