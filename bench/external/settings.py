"""What a user says about a folder that is scored: ``score.yaml`` in it, and options of the command line."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from bench.errors import BenchError, did_you_mean, require_choice
from bench.io.foreign import read_plain_text, reading
from bench.io.yaml_files import parse_yaml

SETTINGS_FILE = "score.yaml"
_MOST_BYTES = 1_000_000
NONE = "none"
"""In place of a file or folder: there is none, don't look for one."""
NUMBERS = ("auto", "frame", "position")
CONVENTIONS = ("auto", "camera_to_world", "world_to_camera")
AXES = ("auto", "opencv", "opengl")
STATES = ("done", "failed", "out_of_memory", "interrupted")
RESOURCES = (
    *("peak_memory_gb", "tracking_s_per_frame", "stereo_s_per_frame", "mapping_s_per_frame", "wall_s_per_frame"),
    "gaussians",
)


@dataclass(frozen=True)
class ScoreSettings:
    """How to read a folder of another system's output.

    ``trajectory``, ``renders``, ``renders_right`` and ``depth`` name a file or folder in it (the last part of the
    latter three may have ``*``), "none" that there is none, and "" has it looked for. ``depth_scale``: what stored
    depth is divided by to give metres; None = 256 for PNG, 1 for .npy. ``numbers``: what file names and lines of a
    trajectory count: "frame" numbers of the data set, "position" 0, 1, 2 ... in the part that is scored, or "auto".
    ``convention`` and ``axes`` of poses: "auto" = those of the file's format, else camera to world and OpenCV's.
    ``held_out``: the system honoured the protocol's held-out frames. ``status`` and ``reason``: how its run ended.
    ``resources``: what is known of memory (GB), seconds per frame and the number of Gaussians, by ``RESOURCES``.
    """

    name: str = ""
    trajectory: str = ""
    renders: str = ""
    renders_right: str = ""
    depth: str = ""
    depth_scale: float | None = None
    numbers: str = "auto"
    convention: str = "auto"
    axes: str = "auto"
    max_time_difference_s: float = 0.01
    held_out: bool = False
    status: str = "done"
    reason: str = ""
    resources: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values; raises ``BenchError`` naming the setting and what is accepted."""
        require_choice("numbers", self.numbers, NUMBERS)
        require_choice("convention", self.convention, CONVENTIONS)
        require_choice("axes", self.axes, AXES)
        require_choice("status", self.status, STATES)
        for name in ("depth_scale", "max_time_difference_s"):
            value = getattr(self, name)
            if value is not None and not 0 < value <= sys.float_info.max:
                raise BenchError(f"{name}={value} must be a number above 0.")
        for name, value in self.resources.items():
            require_choice("resources", name, RESOURCES)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= sys.float_info.max:
                raise BenchError(f"resources.{name}={value} must be a number, 0 or more.")

    def recorded(self) -> dict[str, Any]:
        """The settings that decide how files are read, for the run's config."""
        names = ("depth_scale", "numbers", "convention", "axes", "max_time_difference_s", "held_out")
        return {name: value for name, value in asdict(self).items() if name in names}


def read_settings(folder: Path, options: Mapping[str, Any]) -> ScoreSettings:
    """The settings of ``score.yaml`` in ``folder``, if there is one, and over them the ``options`` that are not None.

    Raises ``BenchError`` for a file that can't be read, an unknown setting, and a value of the wrong type.
    """
    path = folder / SETTINGS_FILE
    written = _read_yaml(path) if path.exists() else {}
    given = {key: value for key, value in options.items() if value is not None}
    _check(str(path), written)
    _check("score", given)
    return ScoreSettings(**written | given)


def _check(where: str, settings: Mapping[str, Any]) -> None:
    accepted = {each.name: each for each in fields(ScoreSettings)}
    for key, value in settings.items():
        if key not in accepted:
            raise BenchError(
                f"{where}: there is no setting '{key}'; there are {', '.join(accepted)}."
                f"{did_you_mean(str(key), accepted)}"
            )
        _check_type(where, key, value, str(accepted[key].type))


def _check_type(where: str, key: str, value: Any, annotation: str) -> None:
    kinds: tuple[str, tuple[type, ...]]
    if annotation.startswith("float"):
        kinds = ("a number", (int, float))
    elif annotation == "bool":
        kinds = ("true or false", (bool,))
    elif annotation == "str":
        kinds = ("text", (str,))
    else:
        kinds = ("a mapping of names to numbers", (dict,))
    wanted, types = kinds
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        raise BenchError(f"{where}: {key} must be {wanted}, and is {value!r}.")


def _read_yaml(path: Path) -> dict[str, Any]:
    with reading(path, "can't be read", "Repair it, or delete it."):
        content = parse_yaml(read_plain_text(path, _MOST_BYTES))
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise BenchError(
            f"{path} should hold settings, one per line as name: value; it holds {type(content).__name__}."
        )
    return content
