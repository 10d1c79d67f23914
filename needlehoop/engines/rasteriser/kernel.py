"""The kernel that draws."""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.desk import Desk, Film, Lens, Poses, eye_of
from needlehoop.engines.rasteriser.exposing import expose
from needlehoop.engines.rasteriser.filling import draw_solid
from needlehoop.engines.rasteriser.solids import Solids

# Sums in any order: a tenth faster. Warp's own headers name infinity and NaN, of which the
# compiler would then warn over a page.
_FLAGS = "-march=native -ffast-math -Wno-nan-infinity-disabled"
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})


@wp.kernel
def draw(
    solids: Solids,
    lenses: wp.array[Lens],
    poses: Poses,
    desk: Desk,
    film: Film,
    size: int,
    first: int,
    last: int,
):
    """Draw environments ``first`` to ``last`` (excluded) through every lens, ``size`` px wide.

    One thread draws them all, one after the other on one desk.
    """
    for env in range(first, last):
        for view in range(lenses.shape[0]):
            lens = lenses[view]
            eye = eye_of(poses, lens, env, size)
            for index in range(solids.solids.shape[0]):
                draw_solid(solids, index, poses, env, eye, desk)
            expose(solids, poses, lens, env, eye, desk, film)
