"""Where named tables are: the bench's own in ``conf/table``, others in ``table/`` of a package or a user's folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.discovery import package_folders
from bench.errors import BenchError, require_choice
from bench.installed_data import config_folder
from bench.tables.named.definitions import NamedTable
from bench.tables.named.loading import read_table

DIALECTS = "dialects"
"""A table of its own kind, of any runs: see ``bench.tables.named.dialects``."""


def table_files(folders: Sequence[str] = ()) -> dict[str, Path]:
    """The file of each named table, by name; ``folders`` are the user's, as in ``plugins=[...]``.

    Raises ``BenchError`` for a folder that is not there, and for two tables of one name.
    """
    found: dict[str, Path] = {}
    users = [Path(folder).expanduser() for folder in folders]
    for folder in users:
        if not folder.is_dir():
            raise BenchError(f"There is no folder {folder} with tables or plugins of yours. Create it, or correct it.")
    for folder in dict.fromkeys([config_folder(), *package_folders(), *(each.resolve() for each in users)]):
        for file in sorted((folder / "table").glob("*.yaml")):
            if file.stem in (*found, DIALECTS):
                other = f"as {found[file.stem]}" if file.stem in found else "as the table of other systems' rules"
                raise BenchError(f"{file} has the same name {other}. Rename the file.")
            found[file.stem] = file
    return found


def table_names(folders: Sequence[str] = ()) -> list[str]:
    """All that ``bgs-bench table`` knows by name."""
    return [*table_files(folders), DIALECTS]


def named_table(name: str, folders: Sequence[str] = ()) -> NamedTable:
    """The table of this name; raises ``BenchError`` with the names there are, and for a file that is wrong."""
    if name == DIALECTS:
        raise BenchError(
            f"The table {DIALECTS} has no cells of its own: it is of any runs. Make some with `bgs-bench run "
            "'evaluator=[ate,image,depth_l1,resources,dialects]' ...` or `bgs-bench reproduce main_kitti "
            f"'evaluator=[...]'`, then `bgs-bench table {DIALECTS} RUN_FOLDER ...`."
        )
    files = table_files(folders)
    return read_table(files[require_choice("table", name, files)], folders)
