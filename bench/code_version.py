"""Which code computes an answer: one hash over a plugin's source file and the project files that it imports."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from functools import cache, lru_cache
from pathlib import Path

import bench

# Of the framework, what a depth map or a sky mask is computed with; the rest (registry, errors, ...) may change freely.
_FRAMEWORK = (
    *("bench.stereo", "bench.sky", "bench.contracts.stereo", "bench.contracts.sky", "bench.geometry", "bench.io"),
)


def code_version(plugin: type) -> str:
    """Hexadecimal SHA-256 over the file of ``plugin`` and the modules that it imports, directly or not, anywhere in it.

    Counted are modules of the plugin's own top-level package and those of the framework that compute; other packages
    are told apart by their versions, elsewhere. The imports are read from the source text, so lazy ones count too.
    """
    own = plugin.__module__.partition(".")[0]
    counted = tuple(prefix for prefix in (own, "bench.builtin", *_FRAMEWORK) if prefix != "bench")
    seen: dict[str, str] = {}
    pending = [(plugin.__module__, Path(inspect.getfile(plugin)))]
    while pending:
        module, file = pending.pop()
        content = file.read_bytes()
        seen[module] = hashlib.sha256(content).hexdigest()
        if file.suffix != ".py":
            continue
        for name in _imports(content, module, file.name == "__init__.py"):
            if name in seen or not any(name == prefix or name.startswith(f"{prefix}.") for prefix in counted):
                continue
            found = _file_of(name)
            if found is not None:
                pending.append((name, found))
    # A user's folder gives its modules another name in each process; the file of the plugin itself needs none.
    seen["plugin"] = seen.pop(plugin.__module__)
    return hashlib.sha256(repr(sorted(seen.items())).encode()).hexdigest()


@lru_cache(maxsize=1)
def project_version() -> str:
    """Hexadecimal SHA-256 over every source file and compiled module of the packages ``bench`` and ``plugins``."""
    root = Path(bench.__file__).parent.parent
    digest = hashlib.sha256()
    for package in ("bench", "plugins"):
        for file in sorted((root / package).rglob("*")):
            if file.suffix in (".py", ".so") and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(root)}\n".encode())
                digest.update(file.read_bytes())
    from bench import _native  # its file lies elsewhere in an editable installation

    digest.update(Path(_native.__file__).read_bytes())
    return digest.hexdigest()


@cache
def _imports(content: bytes, module: str, is_package: bool) -> tuple[str, ...]:
    """Dotted names that may be modules: of ``from a import b`` both ``a`` and ``a.b``."""
    package = module if is_package else module.rpartition(".")[0]
    found: list[str] = []
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            name = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            found += [name, *(f"{name}.{alias.name}" for alias in node.names)]
    return tuple(found)


def _file_of(module: str) -> Path | None:
    """The module's file; None for what is no module (a class) or is not installed."""
    try:
        spec = importlib.util.find_spec(module)
    except ImportError:
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None
