"""Writes the first file of a plugin, and its test: both work before anything is changed in them."""

from __future__ import annotations

import ast
import keyword
from dataclasses import dataclass
from pathlib import Path
from string import Template

from bench import registry
from bench.discovery import FOLDER_OF_KIND
from bench.errors import BenchError, require_choice
from bench.installed_data import config_folder
from bench.io.atomic import write_text
from bench.registry import KINDS, OBSERVERS

TEMPLATES = Path(__file__).parent / "templates"
# Words that Hydra's command line reads as values of their own.
_NOT_NAMES = ("null", "none", "true", "false", "nan", "inf", "default")


@dataclass(frozen=True)
class Place:
    """Where a plugin and its test go; ``own_folder`` is the one for ``plugins=[...]``, None in a checkout."""

    file: Path
    test: Path
    own_folder: Path | None


def checkout_root() -> Path | None:
    """The repository that the package runs from; None where it is installed."""
    root = Path(__file__).parents[2]
    parts = (root / "pyproject.toml", root / "plugins", root / "tests")
    return root if all(part.exists() for part in parts) else None


def place_for(kind: str, name: str, folder: Path | None) -> Place:
    """The files of a new plugin: in ``folder``, else in ``plugins/`` of the checkout, else in ``./my_plugins``.

    Every ``*.py`` directly in an own folder is a plugin, so tests go one deeper; where it has a folder of the kind
    (``stereo/``), the plugin goes there. The test's name ends with the kind: pytest wants each file name once.
    """
    root = checkout_root()
    if folder is None and root is not None:
        of_kind = FOLDER_OF_KIND[kind]
        return Place(
            root / "plugins" / of_kind / f"{name}.py", root / "tests" / of_kind / f"test_{name}_{kind}.py", None
        )
    own = (folder or Path("my_plugins")).expanduser()
    inside = own / FOLDER_OF_KIND[kind]
    return Place((inside if inside.is_dir() else own) / f"{name}.py", own / "tests" / f"test_{name}_{kind}.py", own)


def write_plugin(kind: str, name: str, folder: Path | None = None) -> Place:
    """Write the plugin's file and its test and return where they are.

    Raises ``BenchError`` for an unknown kind, a name that is taken or is no name, a file that is there already, and a
    place that can't be written to; nothing is written then.
    """
    require_choice("kind", kind, KINDS)
    _check_name(kind, name)
    place = place_for(kind, name, folder)
    for file in (place.file, place.test):
        if file.exists():
            raise BenchError(f"{file} is there already and is not overwritten. Choose another name, or remove it.")
    files = {place.file: _plugin_text(kind, name), place.test: _test_text(kind, name, place)}
    for file, text in files.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BenchError(
                f"Can't make the folder {file.parent}: {error.strerror}. Give another --folder."
            ) from error
        write_text(file, text)
    return place


def _check_name(kind: str, name: str) -> None:
    if not name.isidentifier() or not name.isascii() or keyword.iskeyword(name) or name.startswith("_"):
        near = "".join(c if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
        hint = f", for example {near}" if near.isidentifier() and not keyword.iskeyword(near) else ""
        raise BenchError(f"'{name}' can't be a plugin's name: use letters, digits and _, a letter first{hint}.")
    if name.lower() in _NOT_NAMES:
        raise BenchError(f"'{name}' can't be a plugin's name: {kind}={name} means something else on the command line.")
    if name in registry.names(kind):
        known = registry.lookup(kind, name)
        raise BenchError(f"There is a {kind} '{name}' already, in {known.file}. Choose another name.")
    preset = config_folder() / kind / f"{name}.yaml"
    if preset.is_file():
        raise BenchError(f"There is a preset {kind}={name} already, in {preset}. Choose another name.")


def _plugin_text(kind: str, name: str) -> str:
    contract = "observer" if kind in OBSERVERS else kind
    template = Template((TEMPLATES / f"{contract}.txt").read_text(encoding="utf-8"))
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    text = template.substitute(kind=kind, name=name, Class=cls)
    if cls in _imported_names(text):
        text = template.substitute(kind=kind, name=name, Class=f"{cls}Plugin")
    return text


def _imported_names(text: str) -> set[str]:
    imports = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom))
    return {alias.asname or alias.name for node in imports for alias in node.names}


def _test_text(kind: str, name: str, place: Place) -> str:
    own = TEMPLATES / f"test_{kind}.txt"
    template = Template((own if own.is_file() else TEMPLATES / "test.txt").read_text(encoding="utf-8"))
    in_folder = place.own_folder is not None
    text = template.substitute(
        kind=kind,
        name=name,
        path_import="from pathlib import Path\n" if in_folder else "",
        folders=", folders=[str(Path(__file__).parents[1])]" if in_folder else "",
    )
    return text.replace('"""\n\n\n', '"""\n\n')
