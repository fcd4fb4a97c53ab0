"""Every setting is documented where it stands, and wrong values are refused by the config itself."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import pytest

from bench import registry
from bench.cache.settings import CacheConfig
from bench.config import LimitsConfig, RootConfig
from bench.discovery import load_plugins
from bench.errors import BenchError, require_least
from bench.plugin_config import plugin_config_from
from bench.protocol import Protocol
from bench.registry import PluginConfig
from bench.settings import Setting, documented


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
