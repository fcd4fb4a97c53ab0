"""The three routes by which plugins come: files under ``plugins/``, installed packages, and the user's own folders."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import itertools
import pkgutil
import sys
import traceback
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from bench.errors import BenchError
from bench.registry import KINDS, Plugin, broken_files

# The project's own plugins. Where they are installed they lie in bench: `plugins` may be anybody's there.
builtin_plugins = importlib.import_module(
    "bench.builtin.plugins" if (Path(__file__).parent / "builtin").is_dir() else "plugins"
)

ENTRY_POINT_GROUP = "bgs_bench.plugins"
FOLDER_OF_KIND = {
    kind: kind if kind in ("stereo", "sky") else "losses" if kind == "loss" else f"{kind}s" for kind in KINDS
}
"""What the folder of a kind of plugin is called under ``plugins/``."""
_MOST_LOOKED_AT = 200


def load_plugins(folders: Iterable[str] = ()) -> None:
    """Import every plugin; call it as often as you like, also first thing in a worker process.

    ``folders`` are the user's own plugin folders (``plugins=[~/mine]``), of which ``plugin_files`` are imported. A file
    that fails to import is recorded in ``registry.broken_files`` with the reason and breaks nothing else, but two
    plugins of the same name are an error (``BenchError``), and so is a folder without any.
    """
    _load_package(builtin_plugins.__name__, builtin_plugins.__path__)
    for entry in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        _import(entry.module, f"{entry.name} (installed package, {entry.module})")
    for folder in folders:
        _load_folder(Path(folder).expanduser())


def plugin_files(folder: Path) -> list[Path]:
    """The files of a user's folder that are imported: every ``*.py`` directly in it, and in its folders that are called
    as those of ``plugins/`` (``stereo/``, ``losses/``) or as the kind (``loss/``)."""
    of_kinds = sorted({*FOLDER_OF_KIND.values(), *KINDS})
    files = [file for name in of_kinds for file in sorted((folder / name).glob("*.py")) if file.name != "__init__.py"]
    return [*sorted(folder.glob("*.py")), *files]


def package_folders() -> list[Path]:
    """The folders of the installed packages that bring plugins, for what they bring beside Python (tables)."""
    found = []
    for entry in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        spec = importlib.util.find_spec(entry.module.partition(".")[0])
        found += [Path(place) for place in (spec.submodule_search_locations or [] if spec else [])]
    return found


def is_builtin(plugin: Plugin) -> bool:
    """Whether a plugin is the project's own."""
    return plugin.cls.__module__.startswith(f"{builtin_plugins.__name__}.")


@cache
def load_evaluators() -> None:
    """Import the evaluators under ``plugins/`` alone, which is quick: tables ask them for their metrics."""
    _load_package(
        f"{builtin_plugins.__name__}.evaluators",
        [str(Path(place) / "evaluators") for place in builtin_plugins.__path__],
    )


def _load_package(name: str, places: Iterable[str]) -> None:
    for module in pkgutil.walk_packages(places, f"{name}."):
        if not module.ispkg:
            _import(module.name, module.name)


def _load_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise BenchError(f"plugins: the folder {folder} does not exist. Create it, or remove it from plugins=[...].")
    files = plugin_files(folder.resolve())
    # A folder may hold tables or configurations alone.
    if not files and not any(folder.glob("*/*.yaml")):
        raise BenchError(
            f"plugins: the folder {folder} has no plugin files: no *.py in it, nor in a folder of one kind in it "
            f"({', '.join(FOLDER_OF_KIND.values())}).{_elsewhere(folder)}"
        )
    for file in files:
        name = f"_user_plugins_{abs(hash(file.parent)):x}_{file.stem}"
        if name in sys.modules:
            continue
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BenchError:
            del sys.modules[name]
            raise
        except (Exception, SystemExit) as error:
            del sys.modules[name]
            _record(str(file), error)


def _elsewhere(folder: Path) -> str:
    """Where below a folder without plugin files there are some."""
    below = itertools.islice(itertools.chain(folder.glob("*/*.py"), folder.glob("*/*/*.py")), _MOST_LOOKED_AT)
    near = next((file for file in below if "@register(" in file.read_text(encoding="utf-8", errors="replace")), None)
    if near is None:
        return " Make one with `bgs-bench new-plugin KIND NAME --folder FOLDER`."
    return f" There is {near}: name its folder, or the one above if it is called as a kind."


def _import(module: str, label: str) -> None:
    try:
        importlib.import_module(module)
    except BenchError:
        raise
    except (Exception, SystemExit) as error:
        _record(label, error)


def _record(label: str, error: BaseException) -> None:
    where = traceback.extract_tb(error.__traceback__)
    # A syntax error names its place itself; the traceback ends in the import machinery.
    line = f" (line {where[-1].lineno} of {where[-1].filename})" if where and not isinstance(error, SyntaxError) else ""
    broken_files[label] = f"{type(error).__name__}: {error}{line}"
