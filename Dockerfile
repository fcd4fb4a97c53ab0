# bgs-bench on a CPU:
#   docker build -t bgs-bench .
#   docker run --rm -v "$PWD/results:/bench/results" bgs-bench run
FROM python:3.11-slim-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends g++ make git && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
# Dependencies as tested; torch's build for CPUs comes from the index of the environment (PIP_INDEX_URL, PIP_EXTRA_INDEX_URL).
ARG PIP_EXTRA_INDEX_URL
RUN python -m venv /opt/bgs-bench && /opt/bgs-bench/bin/pip install --no-cache-dir --constraint constraints.txt .

FROM python:3.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home bench && mkdir /bench && chown bench /bench
COPY --from=build /opt/bgs-bench /opt/bgs-bench
ENV PATH=/opt/bgs-bench/bin:$PATH
USER bench
WORKDIR /bench
# For LPIPS, as make install does.
RUN bgs-bench weights get alexnet
ENTRYPOINT ["bgs-bench"]
CMD ["--help"]
