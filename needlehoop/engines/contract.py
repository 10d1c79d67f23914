"""Settings of engines and renderers, and what they return. Imports no simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

from needlehoop.config.strict import OneOf, Range, check_names
from needlehoop.runs.machine import available_cpus

if TYPE_CHECKING:
    import torch
    from torch import Tensor

KINDS = ("cpu", "dm_control", "warp")
"""What steps the physics."""

RENDERERS = ("rasteriser", "tracer")
"""What makes the images that agents see."""


@dataclass(frozen=True)
class EngineConfig:
    """Values in ``conf/engine``."""

    threads: Annotated[int, Range(0, 4096)]
    """Threads for physics and cameras; 0: every CPU this process may use."""
    renderer: Annotated[str, OneOf(*RENDERERS)]
    """Pictures for people are always the tracer's."""
    kind: Annotated[str, OneOf(*KINDS)]
    device: Annotated[str, OneOf("cpu", "cuda")] = "cpu"
    """Where ``warp`` steps and draws."""
    contacts: Annotated[int, Range(1, 10_000)] = 32
    """Most contacts of an environment that ``warp`` has room for."""

    def __post_init__(self) -> None:
        if self.kind != "warp" and self.device != "cpu":
            raise ValueError(f"engine.device: {self.device!r} needs engine=warp")
        if self.kind == "warp" and self.renderer != "rasteriser":
            raise ValueError(f"engine.renderer: {self.renderer!r}; engine=warp draws by rasteriser")

    @property
    def torch_device(self) -> torch.device:
        """Where the engine's tensors are; ``ValueError`` if that is not on this machine."""
        import torch

        gpus = ["cuda"] if torch.cuda.is_available() else []
        check_names("engine.device", [self.device], ["cpu", *gpus])
        if self.device == "cpu":
            return torch.device("cpu")
        return torch.device("cuda", torch.cuda.current_device())

    @property
    def cpus(self) -> int:
        """Threads in use: ``threads``, or one for each CPU of this process."""
        return self.threads or available_cpus()


FIELDS = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir")
"""Fields of MjData that a picture depends on."""

OPTICS = {
    "cam_zoom": 1.0,
    "geom_tint": 1.0,
    "geom_sheen": 0.0,
    "lamp_strength": 1.0,
    "table_grain": 0.0,
}
"""Fields that a disturbance may add to them, and their defaults.

``cam_zoom`` ``(n, ncam)``: factors of the focal lengths. ``geom_tint`` ``(n, ngeom, 3)``: factors
of the colours. ``geom_sheen`` ``(n, ngeom)``: strength of highlights. ``lamp_strength`` ``(n, 1)``:
factor of the lamps' light. ``table_grain`` ``(n, 1, 3)``: strength of a pattern, where it begins,
cells per m.
"""

Optics = Callable[[Mapping[str, "Tensor"]], Mapping[str, "Tensor"]]
"""From ``FIELDS`` of all environments, those to draw instead, perhaps with ``OPTICS``."""


class Frame(NamedTuple):
    """The image of one view; ``None`` where a channel was not asked for.

    The tensors are buffers of the engine: valid until its next render.
    """

    bgra: Tensor | None
    """``(n, h, w, 4)`` uint8."""
    depth: Tensor | None
    """``(n, h, w)`` float32, m along the optical axis, 0 where nothing was hit."""
    geom: Tensor | None
    """``(n, h, w)`` int32 geom ids, -1 for nothing."""


class Channels(NamedTuple):
    """The channels that a view is asked for."""

    colour: bool
    depth: bool
    geom: bool
