"""Each check finds the mistake that it is for: a working plugin is spoilt in one place, and the verdict says what is
wrong, how to mend it, and on which line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.authoring.verdict import Finding

_STEREO_RETURN = "return np.where(sixteenths > 0, sixteenths / np.float32(16), np.float32(np.nan))"
_SEGMENT_RETURN = "        return sky"
_GOOD = "np.where(sixteenths > 0, sixteenths / np.float32(16), np.float32(np.nan))"
_TRACK_RETURN = 'return TrackingResult(self.pose, "ok", inliers)'
_WINDOW = "self.window = (*self.window, frame.number)[-self.config.window_size :]"
_LOSS_RETURN = "return (missing**2).mean()"
_BACKWARD = "return self.inner.backward(rendered, grad_color, grad_depth, grad_alpha, pose)"
_RENDER = "return self.inner.render(planes, view, differentiable)"
_SCORE = 'return {"probed": {"path_m": float(steps[steps >= self.config.min_step_m].sum())}}'
_FRAME = "return StereoFrame(self.numbers[position], 0.1 * position, views[0], views[1])"
_MAPPER_PSNR = "psnr_db = float(-10 * np.log10(max(float(np.mean(error**2)), 1e-10)))"

# Kind, check, what is replaced by what, what the finding says, and text on the line that it points to.
MISTAKES = {
    "tensor": ("stereo", "shape and dtype", _GOOD, f"__import__('torch').tensor({_GOOD})", r"a torch\.Tensor", "tensor"),
    "nothing": ("stereo", "shape and dtype", _STEREO_RETURN, "pass", r"returned None \(is a return missing", "def disp"),
    "float64": ("stereo", "shape and dtype", _STEREO_RETURN, f"return {_GOOD}.astype(float)", "float64", "astype"),
    "batch axis": ("stereo", "shape and dtype", _STEREO_RETURN, f"return {_GOOD}[None]", r"\(1, 256, 480\)", "None]"),
    "raises": ("stereo", "shape and dtype", "        sixteenths =", "        1 / 0\n        sixteenths =", "ZeroDivisionError: division by zero", "1 / 0"),
    "zero": ("stereo", "NaN rule", "np.float32(np.nan))", "np.float32(0))", r"[\d.]+% zero", "np.float32(0)"),
    "infinite": ("stereo", "NaN rule", "np.float32(np.nan))", "np.float32(np.inf))", "% infinite", "np.inf"),
    "negative": ("stereo", "NaN rule", _STEREO_RETURN, f"return -{_GOOD}", "% negative", "-np.where"),
    "quarter": ("stereo", "units and sign", "np.float32(16)", "np.float32(64)", "a quarter of the true one", "64"),
    "sixteenths": ("stereo", "units and sign", "np.float32(16)", "np.float32(1)", "16 times the true one", "float32(1)"),
    "sign": ("stereo", "units and sign", _STEREO_RETURN, f"return -{_GOOD}", "the sign is wrong", "-np.where"),
    "share of width": ("stereo", "units and sign", _STEREO_RETURN, f"return {_GOOD} / left.shape[1]", "a share of the image's width", "shape[1]"),
    "depth": ("stereo", "units and sign", _STEREO_RETURN, f"return np.float32(300) / {_GOOD}", "this is depth", "300"),
    "offset": ("stereo", "units and sign", _STEREO_RETURN, f"return {_GOOD} + np.float32(9)", r"off by \+9\.0 px everywhere", "(9)"),
    "short range": ("stereo", "units and sign", "max_disparity: int = 96", "max_disparity: int = 32", "of a textured wall at 41 px is known|no simple relation", "np.where"),
    "right image": ("stereo", "of the left image", _STEREO_RETURN, f"return np.roll({_GOOD}, -24, axis=1)", "this is the right image's disparity", "roll"),
    "random": ("stereo", "determinism", _STEREO_RETURN, f"return {_GOOD} + np.random.rand(*left.shape[:2]).astype(np.float32)", r"gave different results \(largest", "rand"),
    "own buffer": ("stereo", "determinism", _STEREO_RETURN, f"self.buffer = getattr(self, 'buffer', np.zeros(left.shape[:2], np.float32))\n        self.buffer[:] = {_GOOD}\n        return self.buffer", "the next call overwrote", "return self.buffer"),
    "temporal": ("stereo", "determinism", _STEREO_RETURN, f"self.n = getattr(self, 'n', 0) + 1\n        return {_GOOD} + np.float32(self.n)\n\n    def start(self, dataset):\n        self.n = 0", "another disparity after another frame", "class Probed(StereoBackbone)"),
    "input": ("stereo", "inputs", "        sixteenths =", "        left //= 2\n        sixteenths =", "the input left was changed in place", "return np.where"),
    "leak": ("stereo", "memory and speed", _STEREO_RETURN, f"self.kept = [*getattr(self, 'kept', []), {_GOOD}.copy()]\n        return self.kept[-1]", r"calls left [\d.]+ MB behind", "kept[-1]"),
    "no weights": ("stereo", "weights", _STEREO_RETURN, f"return {_GOOD}\n\n    def weights(self):\n        return {{'network': '/not/there.pth'}}", r"weights\(\) names /not/there\.pth", "not/there"),
    "mask of 0 and 1": ("sky", "shape and dtype", _SEGMENT_RETURN, "        return sky.astype(np.uint8)", "uint8", "uint8"),
    "sky in place": ("sky", "inputs", _SEGMENT_RETURN, "        depth.depth[sky] = 0\n        return sky", "depth was changed in place", "return sky"),
    "sky divides": ("sky", "odd scenes", _SEGMENT_RETURN, "        assert sky.any(), 'no sky'\n        return sky", "AssertionError: no sky", "assert sky"),
    "BGRA": ("dataset", "frames", _FRAME, "return StereoFrame(self.numbers[position], 0.1 * position, views[0][:, :, 0], views[1])", r"left image of frame\(0\) is uint8 \(96, 320\)", "[:, :, 0]"),
    "number": ("dataset", "frames", _FRAME, "return StereoFrame(position + 1, 0.1 * position, views[0], views[1])", "is number 1", "position + 1"),
    "times": ("dataset", "timestamps", "0.1 * position, views", "-0.1 * position, views", "timestamps", "-0.1"),
    "exchanged": ("dataset", "rectified", "views[0], views[1])", "views[1], views[0])", r"disparity is -10\.\d px", "views[1], views[0]"),
    "rows": ("dataset", "rectified", "views[0], views[1])", "views[0], np.roll(views[1], 3, axis=0))", r"off by -(2\.9|3\.0) rows", "roll"),
    "shared array": ("dataset", "determinism", _FRAME, "self.b = getattr(self, 'b', views)\n        self.b[0][:], self.b[1][:] = views\n        return StereoFrame(self.numbers[position], 0.1 * position, *self.b)", "before and after the next frame", "*self.b"),
    "no rotation": ("dataset", "ground truth", "poses[:, 0, 3] =", "poses[:, 0, 0] = 2.0\n        poses[:, 0, 3] =", "the rotation is not orthonormal", "return Trajectory"),
    "no baseline": ("dataset", "camera", "(self.baseline, 0.0, 0.0)", "(-self.baseline, 0.0, 0.0)", r"baseline -0\.5", "class Probed|def __init__"),
    "lost with pose": ("tracker", "states and poses", _TRACK_RETURN, 'return TrackingResult(self.pose, "lost", inliers)', "state 'lost' with a pose", '"lost", inliers'),
    "NaN pose": ("tracker", "states and poses", _TRACK_RETURN, 'return TrackingResult(self.pose * np.nan, "ok", inliers)', "NaN or infinity", "np.nan"),
    "positions": ("tracker", "states and poses", "self.numbers.append(frame.number)", "self.numbers.append(frame.number + 5)", r"trajectory\(\) after frame 0 has frames 5", "return Trajectory"),
    "inverse": ("tracker", "accuracy", "self.pose = self.pose @ step", "self.pose = step @ self.pose if len(self.poses) < 2 else self.poses[0]", "a camera that never moves", _TRACK_RETURN),
    "centimetres": ("tracker", "accuracy", "self.pose = self.pose @ step", "step[:3, 3] *= 100\n        self.pose = self.pose @ step", r"path length (9|10)\d\.\d\d of the true", _TRACK_RETURN),
    "times kept wrong": ("tracker", "timestamps", "self.timestamps.append(frame.timestamp)", "self.timestamps.append(frame.number)", "has timestamps", "return Trajectory"),
    "first frame": ("keyframer", "decisions", "due = self.seen % self.config.every == 0", "due = self.seen % self.config.every == 1", "the first tracked frame is no keyframe", "return KeyframeDecision"),
    "window of others": ("keyframer", "decisions", _WINDOW, "self.window = (frame.number - 1, frame.number)", r"holds \[-1\], which never", "return KeyframeDecision"),
    "window without new": ("keyframer", "decisions", _WINDOW, "self.window = self.window", "does not end with the new keyframe 0", "return KeyframeDecision"),
    "window reversed": ("keyframer", "decisions", _WINDOW, "self.window = (*self.window, frame.number)[::-1]", "does not end with|not in order", "return KeyframeDecision"),
    "needs landmarks": ("keyframer", "other trackers", "due = self.seen % self.config.every == 0", "due = len(tracking.landmarks) > 0", "TypeError: object of type 'NoneType' has no len", "len(tracking.landmarks)"),
    "nicer PSNR": ("mapper", "honest report", _MAPPER_PSNR, "psnr_db = 40.0", r"the report says 40\.00 dB, the render has 1\d\.\d\d dB", "return MappingReport"),
    "NaN render": ("mapper", "renders", "color = image.color", "image.color[:] = float('nan')\n        color = image.color", "color holds NaN", "return RenderedView"),
    "unseeded": ("mapper", "determinism", "        error =", "        self.planes[0] += 0.1 * torch.rand(self.gaussians)\n        error =", "the same seed twice gave different", "return MappingReport"),
    "half saved": ("mapper", "saves", "write_ply(path, self.planes)", "write_ply(path, self.planes[:, ::2])", "gaussians says", "def save"),
    "detached": ("loss", "gradient", "(1 - self.config.margin - alpha)", "(1 - self.config.margin - alpha) * alpha.detach()", "the gradient by alpha differs from the value's slope", _LOSS_RETURN),
    "NaN slope": ("loss", "finite", _LOSS_RETURN, "return missing.sqrt().sum()", "the gradient by alpha is not finite", "sqrt"),
    "0 / 0": ("loss", "finite", _LOSS_RETURN, "return missing.sum() / target.depth_mask.sum()", "for no depth known, .* is not finite", "depth_mask"),
    "another blending": ("rasterizer", "worked by hand", _RENDER, "r = self.inner.render(planes, view, differentiable)\n        r.depth = r.depth / r.alpha.clamp_min(1e-6)\n        return r", "colour, depth, alpha are", "return r"),
    "image of noise": ("rasterizer", "images", _RENDER, "r = self.inner.render(planes, view, differentiable)\n        r.color = r.color * 1.01\n        return r", "color of 150 random Gaussians", "return r"),
    "half gradient": ("rasterizer", "gradients", _BACKWARD, "g = self.inner.backward(rendered, grad_color, grad_depth, grad_alpha, pose)\n        g.planes[3:6] *= 2\n        return g", r"the gradient by log scales differs by 1 ", "return g"),
    "no twist": ("rasterizer", "gradients", _BACKWARD, "return self.inner.backward(rendered, grad_color, grad_depth, grad_alpha)", "of other shapes", "grad_alpha)"),
    "numpy number": ("evaluator", "scores", _SCORE, 'return {"probed": {"path_m": steps.sum()}}', r"probed\.path_m is float64", "steps.sum()"),
    "NaN score": ("evaluator", "scores", _SCORE, 'return {"probed": {"path_m": float("nan")}}', r"probed\.path_m is nan", "nan"),
    "taken key": ("evaluator", "scores", _SCORE, 'return {"frames": {"path_m": 1.0}}', "'frames' is the framework's own", "frames"),
    "changes the run": ("evaluator", "run untouched", _SCORE, '(run.path / "status.json").write_text("{}")\n        return {"probed": 1.0}', r"status\.json of the run was changed", "1.0}"),
    "needs renders": ("evaluator", "stopped run", _SCORE, 'return {"probed": float(run.render("left", 0).mean())}', "AttributeError: 'NoneType' object has no attribute 'mean'", "mean()"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found_and_placed(mistake: str, finding_about: Callable[..., Finding], tmp_path: Path) -> None:
    kind, title, old, new, says, on_line = MISTAKES[mistake]
    finding = finding_about(kind, title, (old, new))
    assert finding.state == "FAILED", finding
    assert re.search(says, finding.seen), finding.seen
    assert finding.expected
    file, _, line = finding.place.rpartition(":")
    assert Path(file) == tmp_path / "probed.py"
    pointed_at = Path(file).read_text().splitlines()[int(line) - 1]
    assert any(part in pointed_at for part in (on_line, *on_line.split("|"))), pointed_at
