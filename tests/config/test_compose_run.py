"""A run's configuration from the command line: what is refused, in which words, and what the hash depends on."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import pytest
import yaml

from bench import registry
from bench.config import compose_run, register_schema
from bench.errors import BenchError
from bench.gaussians.seeding import SeedingConfig
from bench.installed_data import config_folder
from bench.plugin_config import plugin_config_from
from bench.registry import PluginConfig, register
from bench.swept_values import compose_sweep
from plugins.mappers.gaussian import GaussianMapperConfig
from plugins.stereo.sgbm import SgbmConfig

REFUSED = {
    "stereo=sgbn": r"Unknown stereo 'sgbn'\. Known: .*sgbm.*\. Did you mean 'sgbm'\?",
    "dataset=kiti": r"Unknown dataset 'kiti'\..*Did you mean 'kitti'\?",
    "sky=horizn": r"Unknown sky 'horizn'\..*Did you mean 'horizon'\?",
    "tracker=ground_truth": r"Unknown tracker 'ground_truth'\..*Did you mean 'groundtruth'\?",
    "keyframer=covisible": r"Unknown keyframer 'covisible'\..*Did you mean 'covisibility'\?",
    "mapper=gausian": r"Unknown mapper 'gausian'\..*Did you mean 'gaussian'\?",
    "loss=[rgb,smoth]": r"Unknown loss 'smoth'\..*Did you mean 'smooth'\?",
    "mapper.rasterizer=cpuu": r"Unknown rasterizer 'cpuu'\..*Did you mean 'cpu'\?",
    "rasterizer=cpu": r"There is no setting 'rasterizer'; there are .*Did you mean 'mapper\.rasterizer'\?",
    "mapper.rasterizer.threads=2": r"mapper\.rasterizer has no setting 'threads'\.",
    "+mapper.rasterizer.threads=2": r"rasterizer=cpu has no setting 'threads'; it has name\.",
    "mapper.rasterizer={name: cpux}": r"Unknown rasterizer 'cpux'\. .*Did you mean 'cpu'\?",
    "threads=-1": r"threads=-1 must be 0 \(all cores\) or a positive number",
    "evaluator=[atee]": r"Unknown evaluator 'atee'\..*Did you mean 'ate'\?",
    "system=bgs_slan": r"system='bgs_slan' is not one of bgs_slam, .*Did you mean 'bgs_slam'\?",
    "protocol=papr": r"protocol='papr' is not one of ",
    "stereo.num_disparites=96": r"stereo has no setting 'num_disparites'; there are .*Did you mean 'num_disparities'\?",
    "mapper.seeding.strid=3": r"mapper\.seeding has no setting 'strid'; there are .*Did you mean 'stride'\?",
    "loss.geo.weigth=2": r"loss\.geo has no setting 'weigth'; there are .*Did you mean 'weight'\?",
    "sed=3": r"There is no setting 'sed'; there are .*Did you mean 'seed'\?",
    "+sed=3": r"There is no setting 'sed'; there are .*Did you mean 'seed'\?",
    "+stereo.num=3": r"stereo=sgbm has no setting 'num'; it has ",
    "+mapper.seeding.num=3": r"mapper.*num",
    "stereo.num_disparities=many": r"stereo\.num_disparities=many: .*'many'.* Integer",
    "mapper.depth_range_m=[1]": r"mapper\.depth_range_m=\[1\.0\] has 1 values; give 2",
    "seed=abc": r"seed=abc: .*'abc'.* Integer",
    "seed=-1": r"seed=-1 is negative; choose 0 or more",
    "seed=???": r"seed has no value \(\?\?\?\)\. Give seed=VALUE",
    "seed=${nowhere}": r"The config can't be resolved: .*nowhere",
    "rerun=perhaps": r"rerun=perhaps: .*'perhaps'.*bool",
    "protocol.alignment=sim3": r"protocol\.alignment='sim3' is not one of se3, none",
    "stereo=[sgbm": r"Can't read the override 'stereo=\[sgbm'.*Write key=value",
    "stereo": r"Can't read the override 'stereo'.*Write key=value",
    "pipeline=serial": r"pipeline='serial' is not one of parallel, sequential",
    "seed=0,1": r"seed=0,1 names several values; add -m",
    "stereo=sgbm,lidar": r"stereo=sgbm,lidar names several values; add -m",
    "mapper=null": r"Unknown mapper 'None'\. Known: ",
    "~mapper": r"No mapper is chosen; there are .*gaussian",
    "plugins=[/not/there]": r"plugins: the folder /not/there does not exist\. Create it, or remove it",
    "plugins=a,b": r"plugins=a,b can't be swept; several folders are written plugins=\[ONE,OTHER\]",
}


def compose_and_type(override: str) -> None:
    """What a run does with its config before anything is built."""
    config = compose_run([override])
    for kind in registry.RUN_KINDS:
        if kind in registry.SEVERAL_AT_ONCE:
            config.several(kind)
        else:
            config.plugin(kind)


@pytest.mark.parametrize("override", REFUSED)
def test_refused_with_one_readable_line(override: str) -> None:
    with pytest.raises(BenchError, match=REFUSED[override]) as caught:
        compose_and_type(override)
    assert "\n" not in str(caught.value)


def test_values_arrive_typed() -> None:
    config = compose_run(
        ["stereo.num_disparities=96", "mapper.seeding.stride=3", "mapper.depth_range_m=[1,50]", "seed=4"]
    )
    stereo = config.plugin("stereo")
    assert isinstance(stereo, SgbmConfig)
    assert stereo.num_disparities == 96
    mapper = config.plugin("mapper")
    assert mapper.seeding.stride == 3  # type: ignore[attr-defined]
    assert list(mapper.depth_range_m) == [1.0, 50.0]  # type: ignore[attr-defined]
    assert config.values["seed"] == 4


@dataclass(frozen=True)
class OutlinedConfig(PluginConfig):
    """Like that of a rasterizer of a user's."""

    width_px: int = 2
    colours: str = field(default="", metadata={"path": True})


@pytest.mark.slow
def test_a_setting_can_be_a_plugin_with_settings_of_its_own(
    clean_registry: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its default, another by name, in a preset, its own settings, a sweep; it is part of the hash."""
    register("rasterizer", "outlined_for_tests", config=OutlinedConfig)(type("Outlined", (), {"__module__": __name__}))
    monkeypatch.chdir(tmp_path)
    usual = compose_run([])
    assert usual.values["mapper"]["rasterizer"] == {"name": "cpu"}
    outlined = compose_run(["mapper=gaussian_fast", "mapper.rasterizer=outlined_for_tests", "mapper.iterations=3"])
    assert outlined.values["mapper"]["rasterizer"] == {"name": "outlined_for_tests", "width_px": 2, "colours": ""}
    assert outlined.plugin("mapper").rasterizer == OutlinedConfig("outlined_for_tests")  # type: ignore[attr-defined]
    fine = ["mapper.rasterizer.width_px=1", "mapper.rasterizer=outlined_for_tests", "mapper.rasterizer.colours=a/b"]
    assert compose_run(fine).plugin("mapper").rasterizer == OutlinedConfig(  # type: ignore[attr-defined]
        "outlined_for_tests", 1, str(tmp_path / "a/b")
    )
    both = compose_sweep(["mapper.rasterizer=cpu,outlined_for_tests"])
    assert both[0].hash == usual.hash != both[1].hash
    with pytest.raises(BenchError, match=r"mapper\.rasterizer has no setting 'width'; .*Did you mean 'width_px'\?"):
        compose_run(["mapper.rasterizer=outlined_for_tests", "mapper.rasterizer.width=1"])
    with pytest.raises(BenchError, match=r"rasterizer\.width_px=x: .*'x'.*Integer"):
        compose_run(["mapper.rasterizer=outlined_for_tests", "mapper.rasterizer.width_px=x"])


def test_a_mapper_without_gaussians_has_no_rasterizer() -> None:
    assert compose_run(["mapper=none"]).values["mapper"] == {"name": "none"}
    with pytest.raises(BenchError, match=r"mapper\.rasterizer=cpu: mapper has no setting 'rasterizer'\."):
        compose_run(["mapper=none", "mapper.rasterizer=cpu"])


@pytest.mark.parametrize("system", ["bgs_slam_letter", "bgs_slam_paper"])
def test_the_papers_presets_have_the_papers_numbers(system: str) -> None:
    """Colour 2.5e-3, rotation 1e-3, scale 1e-3, opacity 5e-2, removal 5e-3; weights .8 .2 .1 .1 .5."""
    config = compose_run([f"system={system}"])
    mapper = config.values["mapper"]
    rates = [mapper[f"{what}_rate"] for what in ("color", "rotation", "scale", "opacity")]
    assert rates == [2.5e-3, 1e-3, 1e-3, 5e-2]
    assert mapper["prune_opacity"] == 5e-3
    weights = {name: term["weight"] for name, term in config.values["loss"].items()}
    assert weights == {"rgb": 0.8, "ssim": 0.2, "geo": 0.1, "normal": 0.1, "smooth": 0.5}


def test_the_letter_says_itself_all_that_decides_its_map() -> None:
    """So that the defaults can change without it: put new settings into its file with what leaves the map as it was."""
    letter = yaml.safe_load((config_folder() / "mapper" / "gaussian_letter.yaml").read_text())
    elsewhere = {"name", "seeding", "rasterizer", "cached_targets", "chunk_memory_mb"}
    assert {f.name for f in fields(GaussianMapperConfig)} - elsewhere <= letter.keys()
    assert {f.name for f in fields(SeedingConfig)} <= letter["seeding"].keys()


def test_the_letter_reads_nothing_into_the_terms() -> None:
    """All of its normals have a kernel in the core; nothing is seeded in the sky and in holes."""
    values = compose_run(["system=bgs_slam_letter"]).values
    assert (values["mapper"]["seeding"]["fill_holes"], values["mapper"]["seeding"]["sky_distance_m"]) == (False, 0.0)
    for name in ("normal", "smooth"):
        assert {key: values["loss"][name][key] for key in ("form", "step", "rendered_depth")} == {
            "form": "points",
            "step": 1,
            "rendered_depth": "raw",
        }


def test_a_presets_settings_for_a_term_that_is_left_out_are_left_out() -> None:
    values = compose_run(["system=bgs_slam_paper", "loss=[rgb,ssim,geo,normal]"]).values
    assert list(values["loss"]) == ["rgb", "ssim", "geo", "normal"]
    assert values["loss"]["normal"]["form"] == "slopes"


@pytest.mark.slow
def test_hash_does_not_depend_on_order_place_or_rerun(tmp_path: Path) -> None:
    (tmp_path / "no_plugin.py").touch()
    base = compose_run(["seed=1", "stereo.num_disparities=96"]).hash
    (tmp_path / "notes.py").touch()  # a folder without plugin files is refused
    same = [
        ["stereo.num_disparities=96", "seed=1"],
        ["seed=1", "stereo=sgbm", "stereo.num_disparities=96"],
        ["seed=1", "stereo.num_disparities=96", f"output={tmp_path}"],
        ["seed=1", "stereo.num_disparities=96", "rerun=true"],
        ["seed=1", "stereo.num_disparities=96", "pipeline=sequential"],
        ["seed=1", "stereo.num_disparities=96", "threads=1"],
        ["seed=1", "stereo.num_disparities=96", f"plugins=[{tmp_path}]"],
        ["seed=1", "stereo.num_disparities=96", "loss.rgb.weight=0.8"],  # the default, said aloud
    ]
    assert {compose_run(overrides).hash for overrides in same} == {base}


@pytest.mark.parametrize(
    "change",
    ["seed=2", "stereo.num_disparities=128", "mapper.seeding.stride=5", "loss.rgb.weight=0.7", "loss=[rgb,geo]"],
)
def test_hash_changes_with_a_value(change: str) -> None:
    assert compose_run([change]).hash != compose_run([]).hash


@dataclass(frozen=True)
class PathConfig(PluginConfig):
    """Like that of a data set on disk."""

    root: str = field(default="", metadata={"path": True})
    label: str = ""


def test_paths_are_absolute_and_home_is_known(
    clean_registry: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative root means the same run as the absolute one; so does ~, which shells leave and Hydra refuses."""
    register("dataset", "on_disk_for_tests", config=PathConfig)(type("OnDisk", (), {"__module__": __name__}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    relative, absolute, home = (
        compose_run(["dataset=on_disk_for_tests", f"dataset.root={root}", "dataset.label=a/b"])
        for root in ("data", tmp_path / "data", "~/data")
    )
    assert relative.values["dataset"] == {
        "name": "on_disk_for_tests",
        "root": str(tmp_path / "data"),
        "label": "a/b",
    }
    assert relative.hash == absolute.hash == home.hash
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.py").touch()  # a folder without plugin files is refused
    assert compose_run(["plugins=[~/mine]"]).values["plugins"] == [str(tmp_path / "mine")]


@pytest.mark.slow
def test_a_sweep_is_composed_before_it_starts() -> None:
    cells = compose_sweep(["seed=0,1", "stereo=sgbm,lidar", "mapper.iterations=range(3,5)"])
    assert len(cells) == 8
    assert len({cell.hash for cell in cells}) == 8
    assert {(c.values["seed"], c.values["stereo"]["name"], c.values["mapper"]["iterations"]) for c in cells} == {
        (seed, stereo, iterations) for seed in (0, 1) for stereo in ("sgbm", "lidar") for iterations in (3, 4)
    }
    with pytest.raises(BenchError, match=r"Unknown stereo 'sgbn'"):
        compose_sweep(["stereo=sgbm,sgbn"])


def test_a_saved_plugin_config_is_checked_too() -> None:
    register_schema()
    assert plugin_config_from("stereo", {"name": "sgbm"}) == SgbmConfig("sgbm")
    with pytest.raises(BenchError, match=r"stereo=sgbm has no setting 'blok_size'; .*Did you mean 'block_size'"):
        plugin_config_from("stereo", {"name": "sgbm", "blok_size": 5})
    with pytest.raises(BenchError, match=r"stereo\.block_size: .*'x'.*Integer"):
        plugin_config_from("stereo", {"name": "sgbm", "block_size": "x"})
    with pytest.raises(BenchError, match=r"Unknown stereo ''"):
        plugin_config_from("stereo", {})


SYSTEMS = sorted(file.stem for file in (config_folder() / "system").glob("*.yaml"))


@pytest.mark.parametrize("system", SYSTEMS)
def test_each_part_of_each_system_can_be_exchanged(system: str) -> None:
    """A preset's settings of a part go with the part: they are not left behind for another one, which lacks them."""
    values = compose_run([f"system={system}", "tracker=stereo_orb", "keyframer=covisibility", "mapper=none"]).values
    assert (values["tracker"]["name"], values["mapper"]["name"], values["system"]) == ("stereo_orb", "none", system)
