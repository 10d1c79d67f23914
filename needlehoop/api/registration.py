"""How Gymnasium comes to know of ``needlehoop/NeedleHoop-v0``, without being imported for it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

ID = "needlehoop/NeedleHoop-v0"


def register() -> None:
    """Register the environment with Gymnasium: now if it is imported, else when it will be.

    Gymnasium takes 0.1 s to import, and numpy with it 0.2 s; those who only read files or
    train with TorchRL need not wait for it. It has had no plugins since 1.0.
    """
    if (module := sys.modules.get("gymnasium")) is not None:
        _tell(module)
    else:
        sys.meta_path.insert(0, _Herald())


class _Herald(MetaPathFinder):
    """Finds ``gymnasium`` as the others do, and registers once it has been executed."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        specs = (finder.find_spec(fullname, path, target) for finder in others)
        spec = next((one for one in specs if one is not None), None)
        if spec is not None and spec.loader is not None:
            self._follow(spec.loader)
        return spec

    def _follow(self, loader: Any) -> None:
        execute = loader.exec_module

        def execute_and_tell(module: ModuleType) -> None:
            execute(module)
            # Asked before (``find_spec`` alone imports nothing), it may have been done since.
            if self in sys.meta_path:
                sys.meta_path.remove(self)
                _tell(module)

        loader.exec_module = execute_and_tell


def _tell(gymnasium: Any) -> None:
    gymnasium.register(
        ID,
        entry_point="needlehoop.api.entries:single",
        vector_entry_point="needlehoop.api.entries:batch",
    )
