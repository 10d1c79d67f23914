"""The kernel that adds flaws to pictures.

The compiler vectorises a ``while`` loop over arrays with known strides, 16 steps at once. So loops
along rows are written as ``while``, and arrays are made from addresses.
"""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

_FLAGS = "-march=native -ffast-math -Wno-nan-infinity-disabled"  # as the rasteriser's
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})

EDGE = wp.constant(12)
"""Bytes of the 3 pixels to each side that a blurred pixel takes in."""

SPARE = wp.constant(5)
"""Rows of the scratch buffer beside the picture's."""

_NEAREST = wp.constant(1e-4)
"""Of a depth with noise, m."""

_BLOOD = wp.constant(wp.vec4(8.0, 8.0, 90.0, 255.0))
"""Colour of what covers the lens, BGRA."""


@wp.struct
class Flaw:
    """The flaws of one picture, in the order in which they act."""

    blur: float
    """Of colours: standard deviation of a Gaussian, px."""
    gain: wp.vec3
    bias: wp.vec3
    """Colours become ``gain`` times themselves plus ``bias``, BGR, grey levels."""
    noise: float
    """Of each pixel and channel: standard deviation, grey levels."""
    depth_noise: float
    """Where there is a reading: standard deviation, m."""
    depth_step: float
    """Depths become whole multiples of it, m."""
    flips: float
    """Share of the pixels that take over a neighbour's label, which shows only along edges."""
    drop: wp.vec3
    """Share of the picture that blood covers; its row and column as shares of height and width."""


@wp.func
def _weight(distance: float, blur: float) -> float:
    """Of a Gaussian. Beyond three deviations there is nothing."""
    share = distance / wp.max(blur, 1e-3)
    return wp.where(share < 3.0, wp.exp(-0.5 * share * share), 0.0)


@wp.func
def _blur_along(
    row: int, image: wp.array2d[wp.uint8], weights: wp.vec4, wide: int, out: wp.array2d[float]
):
    """Blur a row into ``out``, whose row ``wide`` is used on the way; edges are repeated."""
    count = image.shape[1]
    i = wp.int32(0)
    while i < count:
        out[wide, EDGE + i] = float(image[row, i])
        i += 1
    for k in range(EDGE):
        out[wide, k] = out[wide, EDGE + k % 4]
        out[wide, EDGE + count + k] = out[wide, EDGE + count - 4 + k % 4]
    i = wp.int32(0)
    while i < count:
        out[row, i] = (
            weights[0] * out[wide, i + 12]
            + weights[1] * (out[wide, i + 8] + out[wide, i + 16])
            + weights[2] * (out[wide, i + 4] + out[wide, i + 20])
            + weights[3] * (out[wide, i] + out[wide, i + 24])
        )
        i += 1


@wp.func
def _blur_across(
    row: int, height: int, count: int, weights: wp.vec4, seen: int, scratch: wp.array2d[float]
):
    """Blur a row of ``scratch`` with those above and below into its row ``seen``."""
    last = height - 1
    a, b, c = wp.max(row - 1, 0), wp.max(row - 2, 0), wp.max(row - 3, 0)
    d, e, f = wp.min(row + 1, last), wp.min(row + 2, last), wp.min(row + 3, last)
    i = wp.int32(0)
    while i < count:
        scratch[seen, i] = (
            weights[0] * scratch[row, i]
            + weights[1] * (scratch[a, i] + scratch[d, i])
            + weights[2] * (scratch[b, i] + scratch[e, i])
            + weights[3] * (scratch[c, i] + scratch[f, i])
        )
        i += 1


@wp.func
def _expose(
    image: wp.array2d[wp.uint8],
    flaw: Flaw,
    grain: wp.array2d[float],
    scratch: wp.array2d[float],
):
    """Blur, gain, bias and noise of colours BGRA ``(h, 4 w)``; ``grain``: noise, as large.

    ``scratch``: ``(h + SPARE, 4 w + 2 EDGE)``.
    """
    height, count = image.shape[0], image.shape[1]
    gain, bias, noise = height, height + 1, height + 2
    wide, seen = height + 3, height + 4
    for i in range(count):
        colour = i % 4
        scratch[gain, i] = wp.where(colour < 3, flaw.gain[wp.min(colour, 2)], 0.0)
        scratch[bias, i] = wp.where(colour < 3, flaw.bias[wp.min(colour, 2)], 255.0)
        scratch[noise, i] = wp.where(colour < 3, flaw.noise, 0.0)
    one, two, three = _weight(1.0, flaw.blur), _weight(2.0, flaw.blur), _weight(3.0, flaw.blur)
    weights = wp.vec4(1.0, one, two, three) / (1.0 + 2.0 * (one + two + three))
    for row in range(height):
        _blur_along(row, image, weights, wide, scratch)
    for row in range(height):
        _blur_across(row, height, count, weights, seen, scratch)
        i = wp.int32(0)
        while i < count:
            graded = scratch[gain, i] * scratch[seen, i] + scratch[bias, i]
            scratch[seen, i] = graded + scratch[noise, i] * grain[row, i]
            i += 1
        i = wp.int32(0)
        while i < count:
            image[row, i] = wp.uint8(int(wp.clamp(scratch[seen, i], 0.0, 255.0) + 0.5))
            i += 1


@wp.func
def _measure(image: wp.array2d[float], flaw: Flaw, grain: wp.array2d[float]):
    """Noise of the depth ``(h, w)``, where there is a reading; then steps."""
    for row in range(image.shape[0]):
        i = wp.int32(0)
        while i < image.shape[1]:
            noisy = wp.max(image[row, i] + flaw.depth_noise * grain[row, i], _NEAREST)
            image[row, i] = wp.where(image[row, i] > 0.0, noisy, 0.0)
            i += 1
        if flaw.depth_step > 0.0:
            i = wp.int32(0)
            while i < image.shape[1]:
                image[row, i] = wp.rint(image[row, i] / flaw.depth_step) * flaw.depth_step
                i += 1


@wp.func
def _flip(image: wp.array2d[int], flips: float, grain: wp.array2d[float]):
    """Labels ``(h, w)`` of neighbours: half from the left, half from above; none at the border."""
    few, many = 0.5 * flips, 1.0 - 0.5 * flips
    for up in range(image.shape[0]):
        # From the lower right corner: the neighbours still have their own labels.
        row = image.shape[0] - 1 - up
        above = wp.max(row - 1, 0)
        i = wp.int32(image.shape[1] - 1)
        while i > 0:
            beside = wp.where(grain[row, i] < few, image[row, i - 1], image[row, i])
            image[row, i] = wp.where(grain[row, i] > many, image[above, i], beside)
            i -= 1
        image[row, 0] = wp.where(grain[row, 0] > many, image[above, 0], image[row, 0])


@wp.func
def _cover(
    drop: wp.vec3,
    size: wp.vec2i,
    image: wp.array2d[wp.uint8],
    depth: wp.array2d[float],
    geom: wp.array2d[int],
):
    """Cover a disc with blood. Channels without rows are not there."""
    y, x = float(size[1]) * drop[1] - 0.5, float(size[0]) * drop[2] - 0.5
    radius = wp.sqrt(float(size[0] * size[1])) * wp.sqrt(drop[0] / wp.pi)
    for row in range(wp.max(int(y - radius), 0), wp.min(int(y + radius) + 1, size[1])):
        for column in range(wp.max(int(x - radius), 0), wp.min(int(x + radius) + 1, size[0])):
            down, right = float(row) - y, float(column) - x
            if down * down + right * right < radius * radius:
                if image.shape[0] > 0:
                    for colour in range(4):
                        image[row, 4 * column + colour] = wp.uint8(int(_BLOOD[colour]))
                if depth.shape[0] > 0:
                    depth[row, column] = 0.0
                if geom.shape[0] > 0:
                    geom[row, column] = -1


@wp.kernel
def spoil(
    envs: wp.array[int],
    first: int,
    view: int,
    flaws: wp.array2d[Flaw],
    starts: wp.array2d[wp.vec3i],
    normal: wp.uint64,
    uniform: wp.uint64,
    scratch: wp.uint64,
    stride: int,
    colours: wp.uint64,
    depths: wp.uint64,
    geoms: wp.uint64,
    size: wp.vec2i,
):
    """Add flaws to pictures of a view, each by a thread of its own.

    Args:
        envs: environments of the pictures, from the ``first`` on.
        flaws: ``(n, views)``.
        starts: where the noise of colours, depth and labels begins in its table, ``(n, views)``.
        normal: address of a table of normal numbers, float32; ``uniform``: of numbers in [0, 1).
        scratch: address of a buffer for ``_expose``; the next picture's is ``stride`` numbers on,
            0 if they are drawn one after the other.
        colours: address of BGRA pictures ``(k, h, w)``; 0 where there are none. So are
            ``depths`` in m, float32, and ``geoms``, ids, int32.
    """
    at = wp.tid()
    flaw, start = flaws[envs[first + at], view], starts[envs[first + at], view]
    skip, none = wp.uint64(at) * wp.uint64(4 * size[0] * size[1]), wp.uint64(0)
    width, height = size[0], size[1]
    image = wp.array(
        ptr=colours + skip, shape=(wp.where(colours > none, height, 0), 4 * width), dtype=wp.uint8
    )
    depth = wp.array(
        ptr=depths + skip, shape=(wp.where(depths > none, height, 0), width), dtype=float
    )
    geom = wp.array(ptr=geoms + skip, shape=(wp.where(geoms > none, height, 0), width), dtype=int)
    more = flaw.gain - wp.vec3(1.0, 1.0, 1.0)
    graded = wp.dot(more, more) + wp.dot(flaw.bias, flaw.bias)
    if image.shape[0] > 0 and flaw.blur + graded + flaw.noise > 0.0:
        grain = wp.array(
            ptr=normal + wp.uint64(4 * start[0]), shape=(height, 4 * width), dtype=float
        )
        address = scratch + wp.uint64(at) * wp.uint64(4 * stride)
        room = wp.array(ptr=address, shape=(height + SPARE, 4 * width + 2 * EDGE), dtype=float)
        _expose(image, flaw, grain, room)
    if depth.shape[0] > 0 and flaw.depth_noise + flaw.depth_step > 0.0:
        grain = wp.array(ptr=normal + wp.uint64(4 * start[1]), shape=(height, width), dtype=float)
        _measure(depth, flaw, grain)
    if geom.shape[0] > 0 and flaw.flips > 0.0:
        grain = wp.array(ptr=uniform + wp.uint64(4 * start[2]), shape=(height, width), dtype=float)
        _flip(geom, flaw.flips, grain)
    if flaw.drop[0] > 0.0:
        _cover(flaw.drop, size, image, depth, geom)
