"""A run's configuration: composed by Hydra from `conf/` and the plugins' own config dataclasses, checked, hashed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from hydra.errors import ConfigCompositionException, HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]  # comes with omegaconf

from bench import registry
from bench.cache.settings import CacheConfig
from bench.data.places import folder_of
from bench.discovery import load_plugins
from bench.errors import BenchError, did_you_mean, first_line, require_choice
from bench.hydra_settings import EXPERIMENT, SEARCH_PATH, config_folders, configs_in, require_known
from bench.installed_data import config_folder
from bench.override_text import as_one_value, hydra_lines, parse_lines, quoted
from bench.plugin_config import plugin_config_from, plugins_in
from bench.protocol import Protocol
from bench.registry import CHOSEN_KINDS, OBSERVERS, SEVERAL_AT_ONCE, PluginConfig
from bench.runs.config_file import NO_PART_OF_THE_RUN, RUNS_FOLDER
from bench.runs.watchdog import LimitsConfig


@dataclass
class RootConfig:
    """The keys of a run; each kind of plugin has its own group beside them."""

    system: str = ""
    """A set of parts and settings in conf/system: bgs_slam, bgs_slam_fast, bgs_slam_paper or bgs_slam_letter."""
    seed: int = 0
    """Random seed."""
    output: str | None = None
    """The run folder; null: results/runs/HASH, by the hash of the config."""
    rerun: bool = False
    """Run again although the folder holds this run, finished."""
    resume: bool = True
    """A run that was stopped or killed is resumed from its last checkpoint ..."""
    checkpoint_s: float = 30.0
    """... which is written every so many seconds; 0: after each frame, inf: never."""
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    """Where a run ends itself."""
    plugins: list[str] = field(default_factory=list)
    """Folders with plugins of your own."""
    pipeline: str = "parallel"
    """parallel lets tracking and stereo run ahead of mapping, sequential does not; the result is the same."""
    threads: int = 0
    """Threads of the C++ core and of scoring; 0: all cores, or OMP_NUM_THREADS. Any number gives the same bits."""
    cache: CacheConfig = field(default_factory=CacheConfig)
    """The disk cache of depth maps and sky masks."""
    protocol: Any = None
    """How the run is scored; a preset in conf/protocol, or default."""
    dataset: Any = None
    """Data set, one of `bgs-bench list dataset`."""
    stereo: Any = None
    """Stereo backbone, one of `bgs-bench list stereo`."""
    sky: Any = None
    """Sky segmenter, one of `bgs-bench list sky`."""
    tracker: Any = None
    """Tracker, one of `bgs-bench list tracker`."""
    keyframer: Any = None
    """Rule for keyframes, one of `bgs-bench list keyframer`."""
    mapper: Any = None
    """Mapper, one of `bgs-bench list mapper`."""
    loss: Any = None
    """Loss terms, several of `bgs-bench list loss`: loss=[rgb,ssim]."""
    evaluator: Any = None
    """Evaluators, several of `bgs-bench list evaluator`."""
    viewer: Any = None
    """Shows the run while it is made, one of `bgs-bench list viewer`."""
    logger: Any = None
    """Where the run's numbers go while it is made, several of `bgs-bench list logger`: logger=[tensorboard,wandb]."""

    def __post_init__(self) -> None:
        if self.seed >= 2**63:  # what torch takes
            raise BenchError(f"seed={self.seed} is too large; the most is {2**63 - 1}.")
        if self.threads > 1024:
            raise BenchError(f"threads={self.threads} is too large; the core takes up to 1024.")
        if self.seed < 0:
            raise BenchError(f"seed={self.seed} is negative; choose 0 or more.")
        if not self.checkpoint_s >= 0:
            raise BenchError(f"checkpoint_s={self.checkpoint_s} must be 0 or more seconds, or inf for no checkpoints.")
        if self.threads < 0:
            raise BenchError(f"threads={self.threads} must be 0 (all cores) or a positive number.")
        require_choice("pipeline", self.pipeline, ["parallel", "sequential"])


@dataclass(frozen=True)
class RunConfig:
    """A composed, checked configuration: ``values`` as plain data, ``hash`` of all that can change the result."""

    values: dict[str, Any]
    hash: str

    def plugin(self, kind: str) -> PluginConfig:
        """The typed config of the one plugin of a kind."""
        return self._plugins[kind][0]

    def several(self, kind: str) -> list[PluginConfig]:
        """The typed configs of all plugins of a kind of which a run uses several, or perhaps none (viewers)."""
        return self._plugins[kind]

    def parse(self) -> None:
        """Check all settings now, where each part would check its own when it is asked for; raises ``BenchError``."""
        _ = self._plugins, self.protocol, self.limits

    def __reduce__(self) -> tuple[type[RunConfig], tuple[dict[str, Any], str]]:
        # Parsed again in another process, where a user's plugins have yet to be loaded when this arrives.
        return RunConfig, (self.values, self.hash)

    @cached_property
    def _plugins(self) -> dict[str, list[PluginConfig]]:
        chosen = {kind: self.values.get(kind) or {} for kind in CHOSEN_KINDS}
        mappings = {kind: list(of.values()) if kind in SEVERAL_AT_ONCE else [of] for kind, of in chosen.items()}
        if not chosen["viewer"]:
            mappings["viewer"] = []
        return {kind: [plugin_config_from(kind, mapping) for mapping in of] for kind, of in mappings.items()}

    @cached_property
    def protocol(self) -> Protocol:
        """How the run is scored."""
        return Protocol.from_mapping(self.values["protocol"])

    @cached_property
    def cache(self) -> CacheConfig:
        """The disk cache of depth maps and sky masks."""
        return CacheConfig(**self.values["cache"])

    @cached_property
    def limits(self) -> LimitsConfig:
        """Where the run ends itself."""
        return LimitsConfig(**self.values["limits"])

    @property
    def output(self) -> Path:
        """The run folder."""
        return Path(self.values["output"] or RUNS_FOLDER / self.hash)


def register_schema() -> None:
    """Put the root schema and the protocol into Hydra's ConfigStore; as often as you like."""
    store = ConfigStore.instance()
    store.store(name="schema", node=RootConfig)
    store.store(group="protocol", name="default", node=registry.config_node(Protocol()))


def compose_run(overrides: Sequence[str]) -> RunConfig:
    """Compose a run from command-line overrides (Hydra syntax); raises ``BenchError`` with the accepted names."""
    parsed = check_overrides(hydra_lines(overrides))
    with _hydra():
        try:
            composed = compose("config", [_hydra_line(override) for override in parsed])
        except (HydraException, OmegaConfBaseException) as error:
            raise BenchError(_explain(error, parsed)) from error
        except YAMLError as error:
            raise BenchError(
                f"A config of yours is no YAML: {' '.join(str(error).split())}. Mend that line."
            ) from error
    config = resolved(composed)
    if others := [folder for folder in config.values["plugins"] if folder not in plugin_folders(parsed)]:
        raise BenchError(f"A config names the plugin folder {others[0]}; give it on the command line, plugins=[...].")
    config.parse()
    return config


def resolved(composed: DictConfig) -> RunConfig:
    """Plain data and hash of a composed config; relative paths become absolute. ``BenchError`` for what is not set."""
    try:
        values = OmegaConf.to_container(composed, resolve=True)
        missing = sorted(OmegaConf.missing_keys(composed))
    except OmegaConfBaseException as error:
        reason = first_line(error)
        raise BenchError(f"The config can't be resolved: {reason}. Change the value that refers to it.") from error
    if missing:
        raise BenchError(f"{missing[0]} has no value (???). Give {missing[0]}=VALUE.")
    assert isinstance(values, dict)
    plain: dict[str, Any] = {str(key): value for key, value in values.items()}
    _check_root(plain)
    for kind in CHOSEN_KINDS:
        if kind in SEVERAL_AT_ONCE:
            # loss.geo=null leaves the term out, as ~loss.geo does; a part without a name holds a preset's settings for
            # a term that the run leaves out.
            parts = (plain[kind] or {}).items()
            plain[kind] = {name: part for name, part in parts if part is not None and "name" in part}
        elif plain[kind] is None and kind not in OBSERVERS:
            raise BenchError(f"No {kind} is chosen; there are {', '.join(registry.names(kind))}.")
    for kind, mapping in plugins_in(plain):
        _make_paths_absolute(kind, mapping)
    plain["cache"] = dataclasses.asdict(CacheConfig.from_mapping(plain["cache"]))
    return RunConfig(plain, hash_of(plain))


def hash_of(values: Mapping[str, Any]) -> str:
    """Hash of a resolved config: of all that can change a run's result; it names the run's folder."""
    hashed = {key: value for key, value in values.items() if key not in NO_PART_OF_THE_RUN}
    text = json.dumps(hashed, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _check_root(values: Mapping[str, Any]) -> None:
    """Raise ``BenchError`` for a key that no run has (Hydra's ``+key=`` adds any), or a wrong value."""
    accepted = [setting.name for setting in dataclasses.fields(RootConfig)]
    for key in values:
        if key not in accepted:
            raise BenchError(
                f"There is no setting '{key}'; there are {', '.join(accepted)}.{did_you_mean(key, accepted)}"
            )
    RootConfig(**values)


def check_overrides(overrides: Sequence[str]) -> list[Override]:
    """Parse overrides, load the plugins (the user's folders too), and check every choice of a group by name."""
    register_schema()
    parsed = parse_lines(overrides)
    for override in parsed:
        require_known(override)
    folders = config_folders(parsed)
    load_plugins(plugin_folders(parsed))
    parsed = [_as_typed(override) for override in parsed]
    for override in parsed:
        group = _group_of(override)
        if group is None or override.is_delete() or override.is_sweep_override():
            continue
        value = override.value()
        for name in value if isinstance(value, list) else [value]:
            options = options_of(group, folders)
            if group == EXPERIMENT and not options:
                raise BenchError(
                    f"{override.input_line}: there is no {EXPERIMENT}/{name}.yaml of yours. Give --config-dir FOLDER, "
                    "the folder that holds it."
                )
            if str(name) not in options:
                kind = registry.nested_groups.get(group, group)
                if kind in registry.KINDS:
                    _raise_unknown(kind, str(name), options)
                require_choice(group, str(name), options)
    return parsed


def _as_typed(override: Override) -> Override:
    """A path that looks like a number (``output=2024_11``, which Hydra takes for 202411) is kept as it was typed."""
    key, _, typed = (override.input_line or "").partition("=")
    value = None if override.is_sweep_override() or override.is_delete() else override.value()
    if not isinstance(value, int | float) or str(value) == typed or override.key_or_group not in _paths():
        return override
    return parse_lines([f"{key}={quoted(typed)}"])[0]


def _paths() -> set[str]:
    """The settings that are paths, as they are typed."""
    plugins = [registry.lookup(kind, name) for kind in CHOSEN_KINDS for name in registry.names(kind)]
    of_plugins = {
        f"{plugin.prefix}.{f.name}"
        for plugin in plugins
        for f in dataclasses.fields(plugin.config)
        if "path" in f.metadata
    }
    return {"output", "cache.folder", *of_plugins}


def _group_of(override: Override) -> str | None:
    """The config group of which the override chooses a member, ``mapper/rasterizer`` for ``mapper.rasterizer=cpu``."""
    group = override.key_or_group.replace(".", "/")
    if group in registry.nested_groups:
        return None if isinstance(override.value(), dict) else group
    return group if group in (*CHOSEN_KINDS, "system", "protocol", EXPERIMENT) else None


def _hydra_line(override: Override) -> str:
    """The override as Hydra wants it: the choice of a plugin that is another's setting names a group, not a key; an
    experiment is added to what the bench's own config has chosen."""
    group, line = _group_of(override), override.input_line or ""
    if group == EXPERIMENT and not override.is_add():
        return f"+{line}"
    return line.replace(override.key_or_group, group, 1) if group in registry.nested_groups else line


def plugin_folders(parsed: Sequence[Override]) -> list[str]:
    """The user's own folders among parsed overrides (``plugins=[...]``); raises ``BenchError`` for several choices."""
    override = next((o for o in parsed if o.get_key_element() == "plugins"), None)
    if override is None:
        return []
    if override.is_sweep_override():
        raise BenchError(f"{override.input_line} can't be swept; several folders are written plugins=[ONE,OTHER].")
    folders = override.value()
    return [str(folder) for folder in folders] if isinstance(folders, list) else [str(folders)]


def _raise_unknown(kind: str, name: str, options: list[str]) -> typing.NoReturn:
    registry.lookup(kind, name)
    raise BenchError(f"Unknown {kind} '{name}'. Known: {', '.join(options)}.")


def options_of(group: str, folders: Sequence[Path] = ()) -> list[str]:
    """Names that ``group=`` accepts: registered plugins, and the presets in ``conf/`` and the user's ``folders``."""
    presets = set(configs_in([config_folder(), *folders], group))
    stored = {"default"} if group == "protocol" else set()
    return sorted(presets | stored | set(registry.names(registry.nested_groups.get(group, group))))


class _hydra:  # noqa: N801 - reads as a context manager
    def __enter__(self) -> None:
        GlobalHydra.instance().clear()
        self._context = initialize_config_dir(str(config_folder().resolve()), version_base="1.3")
        self._context.__enter__()

    def __exit__(self, *exception: Any) -> None:
        self._context.__exit__(*exception)
        GlobalHydra.instance().clear()


def _explain(error: Exception, parsed: list[Override]) -> str:
    """One sentence for what Hydra or OmegaConf complained about: what, where, and what is accepted."""
    cause = error.__cause__ if isinstance(error, ConfigCompositionException) and error.__cause__ else error
    for override in parsed:
        if override.is_sweep_override():
            one = as_one_value(override.input_line or "")
            return f"{override.input_line} names several values; add -m to run them all. One that has commas: {one}"
    choices = [o.input_line or "" for o in parsed if o.key_or_group == SEARCH_PATH]
    choices += [_hydra_line(o) for o in parsed if _group_of(o) not in (None, *registry.nested_groups)]
    try:
        base = compose("config", choices)
    except (HydraException, OmegaConfBaseException):
        reason = first_line(cause)
        if f"Key '{EXPERIMENT}' not in" in reason:
            reason += "; its file must begin with '# @package _global_'"
        return f"{reason}."
    # Plugins that are settings of others before the settings of those.
    for override in sorted(parsed, key=lambda each: _group_of(each) is None):
        if _hydra_line(override) in choices:
            continue
        unknown = _unknown_setting(base, override.key_or_group)
        if unknown:
            return f"{override.input_line}: {unknown}"
        try:
            composed = compose("config", [*choices, _hydra_line(override)])
        except (HydraException, OmegaConfBaseException) as wrong:
            return f"{override.input_line}: {first_line(wrong.__cause__ or wrong)}"
        if _group_of(override) is not None:
            choices, base = [*choices, _hydra_line(override)], composed
    return first_line(cause)


def _unknown_setting(base: DictConfig, key: str) -> str:
    """What is wrong with a dotted key that ``base`` has not, and the nearest that it has; empty where it has it."""
    node: Any = base
    path = ""
    for part in key.split("."):
        accepted = sorted(str(k) for k in node) if isinstance(node, DictConfig) else []
        if part not in accepted:
            where = f"{path} has no setting '{part}'" if path else f"There is no setting '{part}'"
            shown = ", ".join(each for each in accepted if each != "name")
            near = [*accepted, *([] if path else (group.replace("/", ".") for group in registry.nested_groups))]
            return f"{where}{f'; there are {shown}' if shown else ''}.{did_you_mean(part, near)}"
        path = f"{path}.{part}" if path else part
        node = node[part]
    return ""


def _make_paths_absolute(kind: str, mapping: dict[str, Any]) -> None:
    """Settings marked with ``field(metadata={"path": True})`` are read relative to the current folder, once; an empty
    one that ``"data"`` marks as the root of a data set becomes the folder into which that is fetched."""
    for setting in dataclasses.fields(registry.lookup(kind, mapping["name"]).config):
        value = mapping.get(setting.name)
        if value == "" and "data" in setting.metadata:
            mapping[setting.name] = str(folder_of(setting.metadata["data"]))
        if setting.metadata.get("path") and value:
            mapping[setting.name] = str(Path(value).expanduser().absolute())
