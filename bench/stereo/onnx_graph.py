"""What an ONNX stereo network expects and gives, and the presets of known ones."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StereoGraph:
    """How to talk to an ONNX stereo network: the settings of ``stereo=onnx`` (`bgs-bench list stereo onnx` says what
    they mean), and ``published``, the manifest's name of the weights, or "". Empty names, None and "auto" are read from
    the file's inputs and outputs."""

    left: str = ""
    right: str = ""
    output: str = ""
    stacked: str = "auto"
    layout: str = "auto"
    colours: str = "raw"
    fit: str = "auto"
    pad_multiple: int = 32
    pad_side: str = "centred"
    unit: str = "output"
    gain: float = 1.0
    published: str = ""
    half_left: str = ""
    half_right: str = ""
    channel: int | None = None
    grey: bool | None = None
    bgr: bool = False
    mean: tuple[float, ...] = ()
    std: tuple[float, ...] = ()


CHOICES = {
    "stacked": ("auto", "", "channels", "batch"),
    "layout": ("auto", "nchw", "nhwc"),
    "colours": ("unit", "raw", "signed", "imagenet"),
    "fit": ("auto", "resize", "pad"),
    "pad_side": ("top_right", "bottom_right", "centred"),
    "unit": ("px", "output", "width"),
}

PRESETS = {
    "generic": StereoGraph(),
    # NVIDIA's redtail network; sees 161 x 513 pixels of any image.
    "nvtiny": StereoGraph(
        "left:0", "right:0", "disp:0", "", "nhwc", "unit", "resize", unit="width", published="nvtiny"
    ),
    # FoundationStereo's own export script, and the names that we recommend for exports of IGEV, IGEV++, MoCha, MonSter.
    "left_right_disp": StereoGraph("left", "right", "disp", "", "nchw"),
    # export_onnx of the package stereo-matching 0.2.
    "stereo_matching": StereoGraph("left_values", "right_values", "disparity", "", "nchw", "imagenet"),
}
