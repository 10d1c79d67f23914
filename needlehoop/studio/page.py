"""The page: viser's scene and panels, which pass on what is clicked and show what comes of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser

from needlehoop.disturbances.axes import AXES
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import View, pose_of
from needlehoop.scene.image_size import extent
from needlehoop.studio import judging, placing
from needlehoop.studio.players import BY_HAND, Hand, has_sliders
from needlehoop.studio.stage import Stage
from needlehoop.studio.world import Frame, World


@dataclass(frozen=True)
class Source:
    """Where the scene comes from, and where files go."""

    layouts: Mapping[str, Callable[[], Settings]]
    """Variants of the task by name, the first as it is shown first; composed when chosen."""
    words: Sequence[str]
    """Settings that a training with a saved camera needs as well."""
    conf_dir: str
    """Where views are saved."""
    results: str
    """Where questions to a model are kept."""


class Page:
    """Serves a world; every tab shows the same. ``port``: the first free one from here on."""

    def __init__(self, world: World, source: Source, host: str, port: int):
        self.world, self._source = world, source
        self._thread, self._judging = threading.local(), threading.Lock()
        self._is_closed = False
        settings = world.wish.settings
        self._focus = {name: view.focus for name, view in settings.views.items()}
        self._server = viser.ViserServer(host, port, label="needlehoop studio", verbose=False)
        # viser lets any tab open the page to the internet. This one stays where ``host`` says.
        self._server.request_share_url = lambda verbose=True: None
        self._stage = Stage(self._server.scene, self.choose, self._dragged)
        self._server.initial_camera.look_at = centre = np.asarray(settings.picture.focus)
        self._server.initial_camera.position = centre + np.array((-0.35, -0.65, 0.4))
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        left = gui.add_panel()
        left.dock_left()
        left.set_width(460)
        with left.add_tab("Pictures"):
            self._add_pictures(gui, settings)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Camera"):
            self._add_camera(gui, settings)
        with tabs.add_tab("Arm"):
            self._add_arm(gui, settings)
        with tabs.add_tab("Judge"):
            self._add_judges(gui)
        self._fill()

    def run(self, period: float) -> None:
        """Let the world go on, a step every ``period`` s at most, until it is interrupted."""
        while True:
            due = time.monotonic() + period
            frame = self.world.tick()
            if frame is not None:
                self.show(frame)
            time.sleep(max(0.0, due - time.monotonic()))

    def close(self) -> None:
        """End the server, and what it is judging."""
        self._is_closed = True
        self._server.stop()

    def show(self, frame: Frame) -> None:
        wish = frame.wish
        with self._server.atomic(), self._silent():
            self._stage.show(frame.model, frame.position, frame.quaternion)
            self._stage.place(wish.settings.views, wish.chosen)
            for name, picture in frame.pictures.items():
                self._pictures[name].image = picture
            self._status.content = frame.status
            self.play.label = "Pause" if wish.ahead else "Play"
            self.player.value = wish.player
            if frame.hand is not None and wish.player != BY_HAND:
                where = (*(1e3 * x for x in frame.hand.tip), frame.hand.jaw)
                for slider, value in zip(self.sliders, where, strict=True):
                    slider.value = value

    @contextmanager
    def _silent(self) -> Iterator[None]:
        """Inside, setting a handle does not count as a click."""
        self._thread.silent = True
        try:
            yield
        finally:
            self._thread.silent = False

    def _on(self, handle: Any, does: Callable[[], object]) -> Any:
        """Do something when a handle is used; a mistake is told in the tab that made it."""

        def used(event: viser.GuiEvent) -> None:
            if getattr(self._thread, "silent", False):
                return
            try:
                does()
            except (ValueError, RuntimeError, OSError) as error:
                if event.client is None:
                    raise
                if not self._is_closed:
                    event.client.add_notification("That did not work", str(error), color="red")

        is_button = isinstance(handle, viser.GuiButtonHandle)
        (handle.on_click if is_button else handle.on_update)(used)
        return handle

    def _add_pictures(self, gui: viser.GuiApi, settings: Settings) -> None:
        world, kinds = self.world, tuple(settings.renderings)
        self.rendering = gui.add_dropdown("rendering", kinds, initial_value=world.wish.rendering)
        self._on(self.rendering, lambda: world.want(rendering=self.rendering.value))
        self.axis = self._on(gui.add_dropdown("disturbance", ("none", *AXES)), self._disturb)
        self.severity = self._on(gui.add_slider("severity", 0, 5, 1, 3), self._disturb)
        self._meaning = gui.add_markdown("")
        sizes = f"the agent's {extent(settings.image_size)} px, and {world.size} px"
        blank = np.zeros((8, 16, 3), np.uint8)
        self._pictures = {
            name: gui.add_image(blank, label=f"{name}: {sizes}", jpeg_quality=95)
            for name in settings.views
        }

    def _disturb(self) -> None:
        axis = AXES.get(self.axis.value)
        self._meaning.content = axis.meaning if axis else ""
        self.world.disturb(self.axis.value, self.severity.value)

    def _add_camera(self, gui: viser.GuiApi, settings: Settings) -> None:
        self.view = gui.add_dropdown("camera", tuple(settings.views))
        self._on(self.view, lambda: self.choose(self.view.value))
        # In mm: a browser's field of viser's loses the sign of "-0" while "-0.3" is typed.
        origin = (0.0, 0.0, 0.0)
        self.position = self._on(gui.add_vector3("position, mm", origin, step=1.0), self._moved)
        self.fovy = self._on(gui.add_slider("field of view, °", 1.0, 150.0, 0.1, 20.0), self._seen)
        self.depths = self._on(gui.add_vector2("depths, mm", (1.0, 2.0), step=5.0), self._seen)
        self.aim = self._on(gui.add_button("Aim at the middle"), self._aim)
        with gui.add_folder("Save"):
            self.name = gui.add_text("name", "my_view")
            self.folder = gui.add_text("conf_dir", self._source.conf_dir)
            self.overwrite = gui.add_checkbox("overwrite", False)
            self._on(gui.add_button("Save view"), self.save)
            self._saved = gui.add_markdown("")

    @property
    def _view(self) -> View:
        return self.world.wish.settings.views[self.world.wish.chosen]

    def choose(self, name: str) -> None:
        self.world.want(chosen=name)
        self._fill()

    def _fill(self) -> None:
        view = self._view
        with self._silent():
            self.view.value = self.world.wish.chosen
            x, y, z = (1e3 * pose_of(view)[0]).tolist()
            self.position.value = x, y, z
            self.fovy.value = view.fovy
            self.depths.value = 1e3 * view.near, 1e3 * view.far

    def _put(self, view: View) -> None:
        self.world.place(self.world.wish.chosen, view)

    def _dragged(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        self._put(placing.posed(self._view, position, quaternion))
        self._fill()

    def _moved(self) -> None:
        place = np.array(self.position.value) / 1e3
        self._put(placing.posed(self._view, place, pose_of(self._view)[1]))

    def _seen(self) -> None:
        near, far = (depth / 1e3 for depth in self.depths.value)
        # While somebody types, they may be out of order.
        if 0 < near < far:
            self._put(replace(self._view, fovy=self.fovy.value, near=near, far=far))

    def _aim(self) -> None:
        self._put(placing.aimed(self._view, self._focus[self.world.wish.chosen]))
        self._fill()

    def save(self) -> None:
        """Write the chosen view into the user's config folder, and say how to train with it."""
        name, folder = self.name.value, self.folder.value
        path = placing.save(self._view, name, folder, self.overwrite.value)
        camera = f"cams={self.world.wish.rendering}_{name}"
        command = " ".join(("python train.py", f"conf_dir={folder}", camera, *self._source.words))
        self._saved.content = f"Written: `{path}`\n\n```\n{command}\n```"
        print(f"{path}\n{command}", flush=True)

    def _add_arm(self, gui: viser.GuiApi, settings: Settings) -> None:
        world = self.world
        self.layout = gui.add_dropdown("layout", tuple(self._source.layouts))
        self._on(self.layout, self._lay_out)
        self.seed = gui.add_number("episode seed", settings.seed, min=0, step=1)
        self._on(self.seed, lambda: world.set(seed=int(self.seed.value)))
        has_arm = has_sliders(settings)
        names = (*([BY_HAND] if has_arm else []), *world.players)
        self.player = gui.add_dropdown("who acts", names, initial_value=world.wish.player)
        self._on(self.player, lambda: world.want(player=self.player.value, hand=None))
        self.play = self._on(gui.add_button("Play"), lambda: world.play(not world.wish.ahead))
        self._on(gui.add_button("Step"), world.step)
        self._on(gui.add_button("Restart"), world.restart)
        self._status = gui.add_markdown("")
        self.sliders: list[Any] = []
        if not has_arm:
            return
        task: Any = settings.task
        for axis, low, high in zip("xyz", task.workspace_lower, task.workspace_upper, strict=True):
            slider = gui.add_slider(f"tip {axis}, mm", 1e3 * low, 1e3 * high, 0.1, 1e3 * low)
            self.sliders.append(self._on(slider, self._reach))
        jaw = gui.add_slider("jaw, rad", task.jaw_closed, task.jaw_open, 0.01, task.jaw_open)
        self.sliders.append(self._on(jaw, self._reach))

    def _lay_out(self) -> None:
        self.world.set(task=self._source.layouts[self.layout.value]().task)

    def _reach(self) -> None:
        x, y, z, jaw = (slider.value for slider in self.sliders)
        self.world.reach(Hand((x / 1e3, y / 1e3, z / 1e3), jaw))

    def _add_judges(self, gui: viser.GuiApi) -> None:
        gui.add_markdown("Of the cameras on this page, in the chosen rendering:")
        self._on(gui.add_button("Count pixels"), self.count_pixels)
        self.pixels = gui.add_markdown("")
        self._on(gui.add_button("Probe (minutes)"), self.probe)
        self._progress = gui.add_progress_bar(0.0)
        self._scores = gui.add_markdown("")
        self._on(gui.add_button("Ask a model"), self.ask)
        self._question = gui.add_markdown("")

    @contextmanager
    def _judged(self) -> Iterator[tuple[Settings, tuple[str, ...]]]:
        """The scene and its cameras, for one judge at a time: each takes all processors."""
        if not self._judging.acquire(blocking=False):
            raise ValueError("the page is judging already; wait for that")
        wish = self.world.wish
        try:
            yield wish.settings, tuple(f"{wish.rendering}_{v}" for v in wish.settings.views)
        finally:
            self._judging.release()

    def count_pixels(self) -> None:
        """Show pixels and share hidden of each thing, by view."""
        with self._judged() as (settings, _):
            counts = judging.visibility(settings)
        rows = [
            (view, thing, f"{n:.0f}", "–" if np.isnan(hidden) else f"{hidden:.0%}")
            for view, things in counts.items()
            for thing, (n, hidden) in things.items()
        ]
        self.pixels.content = _table(("camera", "thing", "pixels", "hidden"), rows)

    def probe(self) -> None:
        def progress(share: float) -> None:
            if self._is_closed:
                raise RuntimeError("the page was closed while it judged")
            self._progress.value = 100.0 * share

        with self._judged() as shown:
            scores = judging.probe_scores(*shown, progress)
        rows = [(name, f"{score:.3f}") for name, score in scores.items()]
        self._scores.content = _table(("cameras", "score"), rows)

    def ask(self) -> None:
        """Write the question that ranks the cameras, or show the answer that lies beside it."""
        with self._judged() as shown:
            folder, order = judging.ranking_question(*shown, self._source.results)
        self._question.content = " > ".join(order) or (
            f"Written below `{folder}/asked`. Give `request.md` and its pictures to a model,"
            " save the answer there as `answer.md`, and click again."
        )


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
