"""Every setting is documented where it stands, and wrong values are refused by the config itself."""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass, field, make_dataclass
from typing import Any

import pytest

from bench import registry
from bench.cache.settings import CacheConfig
from bench.config import LimitsConfig, RootConfig
from bench.discovery import load_plugins
from bench.errors import BenchError, require_least
from bench.plugin_config import plugin_config_from
from bench.protocol import Protocol
from bench.registry import PluginConfig
from bench.settings import Setting, check_numbers, documented


@dataclass(frozen=True)
class InnerConfig:
    """Settings within settings."""

    far_m: float = 3.0
    """Two
    lines."""


@dataclass(frozen=True)
class BaseConfig(PluginConfig):
    """Settings that others inherit."""

    weight: float = 1.0
    """Its weight."""
    plain: int = 2


@dataclass(frozen=True)
class DerivedConfig(BaseConfig):
    """Settings of its own, and inherited ones."""

    weight: float = 0.5
    sizes: tuple[int, ...] = (1, 2)
    """Sizes."""
    inner: InnerConfig = field(default_factory=InnerConfig)
    """Never shown: those inside are."""


def test_fields_are_read_with_type_default_and_meaning() -> None:
    """By hand: the base's fields first, a changed default keeps its meaning, nested fields have dotted names."""
    assert documented(DerivedConfig) == [
        Setting("weight", "float", 0.5, "Its weight."),
        Setting("plain", "int", 2, ""),
        Setting("sizes", "tuple[int, ...]", (1, 2), "Sizes."),
        Setting("inner.far_m", "float", 3.0, "Two lines."),
    ]


def test_a_setting_that_must_be_given_has_no_default() -> None:
    @dataclass
    class Config:
        path: str

    assert documented(Config)[0].default is dataclasses.MISSING


def test_every_setting_is_documented() -> None:
    load_plugins()
    configs: dict[str, type] = {"run": RootConfig, "cache": CacheConfig, "limits": LimitsConfig, "protocol": Protocol}
    for kind in registry.KINDS:
        for name in registry.names(kind):
            plugin = registry.lookup(kind, name)
            # Other tests register plugins of their own.
            if "/plugins/" in plugin.file:
                configs[f"{kind}={name}"] = plugin.config
    assert len(configs) > 30
    silent = [f"{where}: {s.name}" for where, config in configs.items() for s in documented(config) if not s.meaning]
    assert not silent, "give these fields a string below them that says what they do:\n" + "\n".join(silent)


def test_a_wrong_value_is_one_plain_sentence() -> None:
    """OmegaConf constructs the config, and hands its ``BenchError`` on as it is."""
    load_plugins()
    with pytest.raises(BenchError, match=r"^stereo\.block_size=4 must be odd, for example 5\.$"):
        plugin_config_from("stereo", {"name": "sgbm", "block_size": 4})
    with pytest.raises(BenchError, match=r"^tracker\.loops\.min_matches=0 is too small; the least is 1\.$"):
        plugin_config_from("tracker", {"name": "stereo_orb", "loops": {"min_matches": 0}})
    with pytest.raises(BenchError, match=r"^dataset\.truck_frames=\[3\] has 1 values; give 2\.$"):
        plugin_config_from("dataset", {"name": "street", "truck_frames": [3]})


def test_not_a_number_is_below_any_least_value() -> None:
    with pytest.raises(BenchError, match=r"^here\.far_m=nan is too small; the least is 0\.$"):
        require_least("here", InnerConfig(far_m=float("nan")), far_m=0)


MAY_BE_INFINITE = {
    *("mapper.follow_corrections_m", "mapper.follow_corrections_deg"),  # the map never follows then
    *("mapper.live_m", "mapper.chunk_memory_mb"),  # all of it stays in memory
    *("tracker.max_depth_m", "mapper.max_depth_m", "mapper.prune_scale_m", "mapper.prune_radius_px"),  # no limit
}
MAY_BE_NEGATIVE = {"stereo.gain", "stereo.mean"}
"""Networks that give the flow have negative disparities, and colours reach from -1 to 1."""


def message(kind: str, name: str, setting: str, value: Any) -> str:
    """What is said about a value when a config is read, as on a command line; empty where it is taken."""
    *outer, last = setting.split(".")
    given = {outer[0]: {last: value}} if outer else {last: value}
    try:
        plugin_config_from(kind, {"name": name} | given)
    except BenchError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("kind", registry.KINDS)
def test_numbers_that_make_no_sense_are_refused_in_one_line(kind: str) -> None:
    """Every setting of every built-in plugin that is a number, or a list of numbers."""
    load_plugins()
    taken, other = [], []
    plugins = [registry.lookup(kind, name) for name in registry.names(kind)]
    for plugin in (plugin for plugin in plugins if "/plugins/" in plugin.file):
        for setting in documented(plugin.config):
            types = set(re.findall(r"\w+", setting.type)) & {"int", "float"}
            wrong = {"int": [10**12, True], "float": [math.nan, math.inf, -math.inf, True], "": []}[
                min(types, default="")
            ]
            for value in [*wrong, *([-2] if types else [])]:
                listed = [value] * max(len(setting.default), 1) if isinstance(setting.default, tuple) else value
                said = message(kind, plugin.name, setting.name, listed)
                at = f"{kind}.{setting.name}"
                allowed = (value == math.inf and at in MAY_BE_INFINITE) or (value == -2 and at in MAY_BE_NEGATIVE)
                if allowed != (not said):
                    taken.append(f"{plugin.name}: {at}={value}")
                elif said and ("\n" in said or setting.name.split(".")[-1] not in said):
                    other.append(said)
    assert not taken, "taken (or refused, where they should not be):\n" + "\n".join(taken)
    assert not other, "no plain sentence that names the setting:\n" + "\n".join(other)


@pytest.mark.parametrize(
    "values",
    [
        {"seed": -1},
        {"seed": 2**64},
        {"checkpoint_s": float("nan")},
        {"checkpoint_s": -1.0},
        {"threads": -1},
        {"threads": 10**6},
    ],
)
def test_a_runs_own_numbers(values: dict[str, Any]) -> None:
    with pytest.raises(BenchError, match=f"^{next(iter(values))}="):
        RootConfig(**values)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, 0.0])
@pytest.mark.parametrize("setting", ["memory_gb", "hours", "stall_minutes"])
def test_limits(setting: str, value: float) -> None:
    with pytest.raises(BenchError, match=rf"^limits\.{setting}="):
        LimitsConfig(**{setting: value})


@pytest.mark.parametrize("setting", ["holdout_every", "holdout_remainder", "depth_min_m", "depth_max_m"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1, 10**12])
def test_a_protocols_numbers(setting: str, value: float) -> None:
    values = {"holdout_every": 3, setting: value}
    with pytest.raises(BenchError, match=r"^protocol\."):
        Protocol(**values)


def test_a_plugin_of_the_users_is_checked_too() -> None:
    """One whose config has no check of its own; an infinite default of theirs would need the field's word."""
    check_numbers("mine", DerivedConfig())
    unset = make_dataclass("Unset", [("limit_m", float, math.inf), ("height_m", float, math.nan)])
    check_numbers("mine", unset())
    with pytest.raises(BenchError, match=r"^mine\.limit_m=-inf is no number"):
        check_numbers("mine", unset(limit_m=-math.inf))
    with pytest.raises(BenchError, match=r"^mine\.weight=nan is no number to work with; give a finite one\.$"):
        check_numbers("mine", DerivedConfig(weight=float("nan")))
    with pytest.raises(BenchError, match=r"^mine\.inner\.far_m=inf is no number"):
        check_numbers("mine", DerivedConfig(inner=InnerConfig(float("inf"))))
    with pytest.raises(BenchError, match=r"^mine\.sizes=4294967296 is too large; the most is 2147483647\.$"):
        check_numbers("mine", DerivedConfig(sizes=(1, 2**32)))
