"""The page: viser's scene and panels, which pass on what is clicked and show what comes of it."""

from __future__ import annotations

import csv
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import viser
from viser import uplot

from needlehoop.disturbances.axes import AXES
from needlehoop.envs.settings import Settings
from needlehoop.runs.files import EVALUATIONS
from needlehoop.runs.reading import TABLE, read_text
from needlehoop.scene.cameras import View, pose_of
from needlehoop.studio import judging, placing
from needlehoop.studio.players import BY_HAND, has_sliders
from needlehoop.studio.stage import Stage
from needlehoop.studio.world import Frame, World

_NONE = "none"

_CURVES = ("success", "return")
"""Columns of a run's evaluations that are drawn."""


@dataclass(frozen=True)
class Source:
    """Where the page's scene came from, and where its files go."""

    layouts: Mapping[str, Callable[[], Settings]]
    """The task's variants by name, the first as it is shown first; composed when chosen."""
    words: Sequence[str]
    """Settings that a training needs as well."""
    conf_dir: str
    """Where views are saved."""
    results: str
    """Where questions to a model are kept."""
    run: Path | None
    """A run's folder, whose curves are shown."""
    model: str = "a model"
    """Who answers questions, for the record."""
    size: int = 384
    """Pixels of the pictures in questions."""


class StoppedError(Exception):
    """The page was closed while it judged."""


class Page:
    """Serves a world; every tab shows the same.

    Args:
        port: the first free one from here on is taken.
    """

    def __init__(self, world: World, source: Source, host: str, port: int):
        self._world, self._source = world, source
        self._own = threading.local()
        self._judging, self._closed = threading.Lock(), threading.Event()
        settings = world.wish.settings
        self._focus = {name: view.focus for name, view in settings.views.items()}
        self._pictures: dict[str, viser.GuiImageHandle] = {}
        self._server = viser.ViserServer(host, port, label="needlehoop studio", verbose=False)
        self.address = f"http://{host}:{self._server.get_port()}"
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._stage = Stage(self._server.scene, self.choose, self._dragged)
        centre = np.asarray(settings.picture.focus)
        self._server.initial_camera.position = centre + np.array((-0.35, -0.65, 0.4))
        self._server.initial_camera.look_at = centre
        with self._add_images(settings):
            self._add_pictures(settings)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Camera"):
            self._add_camera(settings)
        with tabs.add_tab("Arm"):
            self._add_player(settings)
        with tabs.add_tab("Judge"):
            self._add_judges()
        if source.run is not None:
            with tabs.add_tab("Run"):
                self._add_curves(source.run)
        self._fill(self._view)

    def run(self, period: float) -> None:
        """Let the world go on, a step every ``period`` s at most, until it is interrupted."""
        while True:
            due = time.monotonic() + period
            frame = self._world.tick()
            if frame is not None:
                self.show(frame)
            time.sleep(max(0.0, due - time.monotonic()))

    def close(self) -> None:
        """End the server, and what it is judging."""
        self._closed.set()
        self._server.stop()

    @contextmanager
    def _silent(self) -> Iterator[None]:
        """Handles may be set without being taken for clicked."""
        self._own.silent = True
        try:
            yield
        finally:
            self._own.silent = False

    def _on(self, handle: Any, does: Callable[[], object]) -> Any:
        """Do something when a handle is used; a mistake is told in the tab that made it."""

        @wraps(does)
        def used(event: viser.GuiEvent) -> None:
            if getattr(self._own, "silent", False):
                return
            try:
                does()
            except StoppedError:
                return
            except (ValueError, RuntimeError, OSError) as error:
                if event.client is None:
                    raise
                event.client.add_notification("That did not work", str(error), color="red")

        is_button = isinstance(handle, viser.GuiButtonHandle)
        (handle.on_click if is_button else handle.on_update)(used)
        return handle

    def _add_images(self, settings: Settings) -> Any:
        panel = self._server.gui.add_panel()
        panel.dock_left()
        panel.set_width(460)
        return panel.add_tab("What the cameras see")

    def _add_pictures(self, settings: Settings) -> None:
        gui, world = self._server.gui, self._world
        kinds = tuple(settings.renderings)
        rendering = gui.add_dropdown("rendering", kinds, initial_value=world.wish.rendering)
        self._on(rendering, lambda: world.want(rendering=rendering.value))
        axis = gui.add_dropdown("disturbance", (_NONE, *AXES))
        severity = gui.add_slider("severity", 0, 5, 1, 3)

        def disturb() -> None:
            meaning = AXES[axis.value].meaning if axis.value in AXES else ""
            self._meaning.content = meaning
            world.disturb(axis.value, severity.value)

        self._on(axis, disturb)
        self._on(severity, disturb)
        self._meaning = gui.add_markdown("")
        self.rendering, self.axis, self.severity = rendering, axis, severity
        for name in settings.views:
            label = f"{name}: the agent's {settings.image_size} px, and {world.size} px"
            blank = np.zeros((8, 16, 3), np.uint8)
            self._pictures[name] = gui.add_image(blank, label=label, jpeg_quality=95)

    def _add_camera(self, settings: Settings) -> None:
        gui = self._server.gui
        self.view = gui.add_dropdown("camera", tuple(settings.views))
        self._on(self.view, lambda: self.choose(self.view.value))
        self.position = gui.add_vector3("position, m", (0.0, 0.0, 0.0), step=0.001)
        self._on(self.position, self._placed)
        self.fovy = gui.add_slider("field of view, °", 1.0, 150.0, 0.1, 20.0)
        self.near = gui.add_number("near depth, m", 0.1, min=0.001, step=0.005)
        self.far = gui.add_number("far depth, m", 1.0, min=0.002, step=0.005)
        for handle in (self.fovy, self.near, self.far):
            self._on(handle, self._changed)
        self.aim = self._on(gui.add_button("Aim at the middle"), self._aim)
        with gui.add_folder("Save"):
            self.name = gui.add_text("name", "my_view")
            self.folder = gui.add_text("conf_dir", self._source.conf_dir)
            self.overwrite = gui.add_checkbox("overwrite", False)
            self._on(gui.add_button("Save view"), self.save)
            self._saved = gui.add_markdown("")

    def _add_player(self, settings: Settings) -> None:
        gui, world, source = self._server.gui, self._world, self._source
        self.layout = gui.add_dropdown("layout", tuple(source.layouts))
        self._on(self.layout, self._lay_out)
        self.seed = gui.add_number("episode seed", settings.seed, min=0, step=1)
        self._on(self.seed, lambda: world.set(seed=int(self.seed.value)))
        who = (*([BY_HAND] if has_sliders(settings) else []), *world.players)
        self.player = gui.add_dropdown("who acts", who, initial_value=world.wish.player)
        self._on(self.player, lambda: world.want(player=self.player.value, hand=None))
        self.play = gui.add_button("Play")
        self._on(self.play, lambda: world.play(not world.wish.playing))
        self._on(gui.add_button("Step"), world.step)
        self._on(gui.add_button("Restart"), world.restart)
        self._status = gui.add_markdown("")
        self.sliders: list[Any] = []
        if has_sliders(settings):
            task: Any = settings.task
            ends = zip("xyz", task.workspace_lower, task.workspace_upper, strict=True)
            for axis, low, high in ends:
                low, high = 1e3 * low, 1e3 * high
                self.sliders.append(gui.add_slider(f"tip {axis}, mm", low, high, 0.1, low))
            jaw = task.jaw_closed, task.jaw_open
            self.sliders.append(gui.add_slider("jaw, rad", *jaw, 0.01, jaw[0]))
            for slider in self.sliders:
                self._on(slider, self._reach)

    def _add_judges(self) -> None:
        gui = self._server.gui
        gui.add_markdown("Of the cameras on this page, in the chosen rendering:")
        self._on(gui.add_button("Count pixels"), self.count_pixels)
        self.pixels = gui.add_markdown("")
        self._on(gui.add_button("Probe (minutes)"), self.probe)
        self.progress = gui.add_progress_bar(0.0)
        self.scores = gui.add_markdown("")
        self._on(gui.add_button("Ask a model"), self.ask)
        self.question = gui.add_markdown("")

    def _add_curves(self, run: Path) -> None:
        path = run / EVALUATIONS
        rows = [*csv.DictReader(read_text(path, TABLE).splitlines())] if path.exists() else []
        if not rows:
            self._server.gui.add_markdown(f"{run} has no evaluations yet.")
        for name in _CURVES if rows else ():
            data = [np.array([float(row[key] or "nan") for row in rows]) for key in ("step", name)]
            series = (uplot.Series(label="step"), uplot.Series(label=name, stroke="#c85010"))
            plain = {"x": uplot.Scale(time=False)}
            self._server.gui.add_uplot((*data,), series, title=name, scales=plain, aspect=1.8)

    def show(self, frame: Frame) -> None:
        """Show a moment in every tab."""
        with self._server.atomic(), self._silent():
            self._stage.show(frame.model, frame.position, frame.quaternion)
            self._stage.place(frame.wish.settings.views, frame.wish.chosen)
            for name, picture in frame.pictures.items():
                self._pictures[name].image = picture
            self._status.content = frame.status
            self.play.label = "Pause" if frame.wish.playing else "Play"
            self.player.value = frame.wish.player
            if frame.hand is not None and frame.wish.player != BY_HAND:
                where = (*(1e3 * x for x in frame.hand.tip), frame.hand.jaw)
                for slider, value in zip(self.sliders, where, strict=True):
                    slider.value = value

    # Cameras.

    def choose(self, name: str) -> None:
        """Choose the camera that the panel and the handle move."""
        self._world.want(chosen=name)
        self._fill(self._view)

    def _fill(self, view: View) -> None:
        """Show a view's numbers."""
        with self._silent():
            self.view.value = self._chosen
            self.position.value = tuple(pose_of(view)[0].tolist())
            self.fovy.value, self.near.value, self.far.value = view.fovy, view.near, view.far

    @property
    def _chosen(self) -> str:
        return self._world.wish.chosen

    @property
    def _view(self) -> View:
        return self._world.wish.settings.views[self._chosen]

    def _put(self, view: View) -> None:
        self._world.place(self._chosen, view)
        self._fill(view)

    def _dragged(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        self._put(placing.posed(self._view, position.tolist(), quaternion.tolist()))

    def _placed(self) -> None:
        self._put(placing.posed(self._view, self.position.value, pose_of(self._view)[1].tolist()))

    def _changed(self) -> None:
        values = {key: getattr(self, key).value for key in ("fovy", "near", "far")}
        self._put(replace(self._view, **values))

    def _aim(self) -> None:
        self._put(placing.aimed(self._view, self._focus[self._chosen]))

    def save(self) -> None:
        """Write the chosen view into the user's config folder, and say how to train with it."""
        name, folder = self.name.value, self.folder.value
        path = placing.save(self._view, name, folder, self.overwrite.value)
        camera = f"{self._world.wish.rendering}_{name}"
        said = placing.train_command(folder, camera, self._source.words)
        self._saved.content = f"Written: `{path}`\n\n```\n{said}\n```"
        print(f"{path}\n{said}", flush=True)

    # The arm.

    def _lay_out(self) -> None:
        found = self._source.layouts[self.layout.value]()
        self._world.set(task=found.task)

    def _reach(self) -> None:
        x, y, z, jaw = (slider.value for slider in self.sliders)
        self._world.reach((x / 1e3, y / 1e3, z / 1e3), jaw)

    # Judging.

    @property
    def _shown(self) -> tuple[Settings, tuple[str, ...]]:
        wish = self._world.wish
        return wish.settings, tuple(f"{wish.rendering}_{view}" for view in wish.settings.views)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """One judge at a time: each takes all processors."""
        if not self._judging.acquire(blocking=False):
            raise ValueError("the page is judging already; wait for that")
        try:
            yield
        finally:
            self._judging.release()

    def count_pixels(self) -> None:
        """Show pixels and share hidden of each thing, by view."""
        with self._alone():
            found = judging.visibility(self._shown[0])
        lines = ["| camera | thing | pixels | hidden |", "|---|---|---|---|"]
        for view, own in found.items():
            for thing, seen in own.items():
                hidden = "–" if np.isnan(seen.hidden) else f"{seen.hidden:.0%}"
                lines.append(f"| {view} | {thing} | {seen.pixels:.0f} | {hidden} |")
        self.pixels.content = "\n".join(lines)

    def probe(self, **changes: Any) -> None:
        """Show the probe's scores; ``changes`` as for ``judging.probe_scores``."""

        def told(share: float) -> None:
            if self._closed.is_set():
                raise StoppedError
            self.progress.value = 100.0 * share

        with self._alone():
            scores = judging.probe_scores(*self._shown, told, **changes)
        lines = [f"| {name} | {score:.3f} |" for name, score in scores.items()]
        self.scores.content = "\n".join(["| cameras | score |", "|---|---|", *lines])

    def ask(self) -> None:
        """Write the question that ranks the cameras, or show the answer that lies beside it."""
        own = self._source
        with self._alone():
            folder, order = judging.ranking_question(*self._shown, own.results, own.size, own.model)
        if order:
            self.question.content = " > ".join(order)
        else:
            self.question.content = (
                f"Written below `{folder}/asked`. Give `request.md` and its pictures to a model,"
                " save the answer there as `answer.md`, and click again."
            )
