"""A plugin of pytest: the build of the core at ``$BGS_CORE`` in place of the installed one (``make sanitize``)."""

from __future__ import annotations

import importlib.util
import os
import sys

import bench

spec = importlib.util.spec_from_file_location("bench._native", os.environ["BGS_CORE"])
assert spec is not None
assert spec.loader is not None
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
sys.modules["bench._native"] = module
vars(bench)["_native"] = module
