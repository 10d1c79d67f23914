"""The task as a Gymnasium vector environment, on the batched engine."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from needlehoop.config.strict import check_names
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Observer, StepResult
from needlehoop.pictures.stills import Photographer
from needlehoop.scene.image_size import sides

MODES = ("rgb_array",)
"""Of rendering."""

Observation = dict[str, np.ndarray]


class GymnasiumVectorEnv(VectorEnv):
    """``num_envs`` environments in one process and one engine, stepped together.

    Observations, actions and ``info`` are those of ``GymnasiumEnv`` with a dimension ``n`` in
    front; ``infos`` has Gymnasium's ``_<name>`` masks. ``reset(seed=s)`` begins the first
    episodes of the seed's environments 0 to ``n - 1``: those of ``TorchRLEnv`` with that
    seed, and in environment 0 that of ``GymnasiumEnv``.

    What happens to an environment whose episode is over is Gymnasium's ``AutoresetMode``:

    - ``NEXT_STEP``: its next step begins an episode; that action is ignored, the reward is 0.
    - ``SAME_STEP``: the same step does; ``infos["final_obs"]`` (an array of observations or
      ``None``) and ``infos["final_info"]`` have what the episode ended with.
    - ``DISABLED``: nothing; reset it with ``options={"reset_mask": mask}`` before the next step.

    A reset with a mask returns the observations of all and the infos of those in the mask.

    The settings' ``seed`` is ignored. ``channels``: of images: ``last``, ``(h, w, c)``, or
    ``first``, ``(c, h, w)``; ``render_mode``: ``rgb_array`` or ``None``; ``render_size``: height
    and width of a rendered picture, px; ``autoreset_mode``: as above, or its value: ``NextStep``,
    ``SameStep``, ``Disabled``. ``ValueError``: settings that do not go together, by key.
    """

    def __init__(
        self,
        settings: Settings,
        channels: str = "last",
        render_mode: str | None = None,
        render_size: int = 480,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ):
        mode: Any = getattr(autoreset_mode, "value", autoreset_mode)
        check_names("autoreset_mode", [mode], [option.value for option in AutoresetMode])
        check_names("render_mode", [render_mode] if render_mode is not None else [], MODES)
        check_names("channels", [channels], ("last", "first"))
        if not (settings.cams or settings.vectors):
            raise ValueError(
                "cams: nothing is observed; name cameras, such as dep_front,seg_side, or choose"
                " obs=signals or obs.proprio=true"
            )
        self.settings, self.render_mode, self.num_envs = settings, render_mode, settings.num_envs
        self.autoreset_mode = AutoresetMode(mode)
        self.metadata = {
            "render_modes": [*MODES],
            "render_fps": 1.0 / settings.period,
            "autoreset_mode": self.autoreset_mode,
        }
        self.simulation = build(settings)
        """The simulation inside: signals, state, engine."""
        self._observer = Observer(self.simulation)
        model = self.simulation.engine.model
        self._photographer = Photographer(model, render_size) if render_mode else None
        self._is_last = channels == "last"
        self.single_observation_space = self._space(settings)
        size = settings.episode.action_size
        self.single_action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)

    def _space(self, settings: Settings) -> spaces.Dict:
        width, height = sides(settings.image_size)
        boxes: dict[str, spaces.Space] = {}
        for name, count in settings.image_channels.items():
            shape = (height, width, count) if self._is_last else (count, height, width)
            boxes[name] = spaces.Box(0, 255, shape, np.uint8)
        for name, length in settings.vectors.items():
            low, high = (0.0, 1.0) if name == "privileged_facts" else (-np.inf, np.inf)
            boxes[name] = spaces.Box(low, high, (length,), np.float32)
        return spaces.Dict(boxes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes: everywhere, or where ``options["reset_mask"]`` ``(n,)`` bool is true.

        ``ValueError``: an unknown option, or a mask with a seed, which is of all environments.
        ``ResetNeeded``: a mask before the first reset.
        """
        check_names("options", [*(options or ())], ("reset_mask",))
        if options:
            if seed is not None:
                raise ValueError("seed: it is of all environments; give it without a reset_mask")
            self.check_begun()
            mask = np.asarray(options["reset_mask"], dtype=np.bool_)
            moment = self.begin(mask=mask)
            self._over &= ~mask
            return self.look(moment, mask), masked(info(moment), mask)
        super().reset(seed=seed)
        if seed is None and self.simulation.state is None:
            seed = self.np_random_seed
        moment = self.begin(seed)
        self._over[:] = False
        return self.look(moment), self._infos(moment)

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step of every environment; rewards float64, all ``(n,)``.

        ``ResetNeeded``: before the first reset, or an episode is over and the mode is
        ``DISABLED``. ``InvalidAction``: another shape than ``(n, action_size)``. ``ValueError``: a
        number that is not finite.
        """
        self.check_begun()
        actions = checked(actions, self.action_space)
        before, mode = self._over, self.autoreset_mode
        if mode == AutoresetMode.DISABLED and before.any():
            raise ResetNeeded(
                f"environments {before.nonzero()[0].tolist()} are over; reset them with"
                " options={'reset_mask': mask}"
            )
        renewed = before if mode == AutoresetMode.NEXT_STEP else before & False
        moment = self.advance(np.where(renewed[:, None], 0.0, actions))
        # What the step paid and ended; zero where an episode begins in it.
        rewards, terminated, truncated = (
            np.where(renewed, np.zeros_like(value), value)
            for value in (_array(t) for t in (moment.reward, moment.terminated, moment.truncated))
        )
        if renewed.any():
            moment = self.begin(mask=renewed)
        self._over = over = terminated | truncated
        seen, infos = self.look(moment), {}
        if mode == AutoresetMode.SAME_STEP and over.any():
            final = np.full(self.num_envs, None, dtype=object)
            for env in over.nonzero()[0]:
                final[env] = {name: value[env].copy() for name, value in seen.items()}
            infos = {"final_obs": final, "final_info": masked(info(moment), over)}
            infos |= {f"_{name}": over.copy() for name in infos}
            moment = self.begin(mask=over)
            seen = self.look(moment, over)
        return seen, rewards, terminated, truncated, {**infos, **self._infos(moment)}

    def render(self) -> tuple[np.ndarray, ...] | None:
        """The scene in each environment ``(size, size, 3)`` uint8."""
        draw, engine = self._photographer, self.simulation.engine
        return draw and tuple(draw(engine.data(env)) for env in range(self.num_envs))

    # What the other classes of this package use too.

    def begin(self, seed: int | None = None, mask: np.ndarray | None = None) -> StepResult:
        """Begin episodes where ``mask`` ``(n,)`` is true, or all; with a seed, its first."""
        if seed is not None:
            self.simulation.reseed(seed)
        if self.simulation.state is None:
            self._observer.pixels = {}
        return self.simulation.reset(None if mask is None else self._here(mask))

    def advance(self, actions: np.ndarray) -> StepResult:
        """One control step of every environment under ``(n, action_size)``, and nothing else."""
        # A copy: torch would warn of arrays that it may not write to.
        return self.simulation.step(self._here(np.array(actions, dtype=np.float64)))

    def look(self, moment: StepResult, mask: np.ndarray | None = None) -> Observation:
        """What all ``n`` environments observe at the present moment, as new arrays by name.

        Images are new where ``mask`` ``(n,)`` is true (everywhere by default).
        """
        ids = None if mask is None else self._here(mask.nonzero()[0])
        seen: dict[str, Any] = {**self._observer(moment.signals, ids)}
        pixels = seen.pop("pixels", {})
        if self._is_last:
            pixels = {name: image.permute(0, 2, 3, 1) for name, image in pixels.items()}
        # Copies: the observer keeps its images, and callers may write to theirs.
        return {name: _array(value) for name, value in (pixels | seen).items()}

    def _here(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.simulation.device)

    def check_begun(self) -> None:
        """Raises ``ResetNeeded`` before the first reset."""
        if self.simulation.state is None:
            raise ResetNeeded("reset all environments first")

    def _infos(self, moment: StepResult) -> dict[str, Any]:
        return masked(info(moment), np.ones(self.num_envs, dtype=np.bool_))


def checked(action: Any, space: spaces.Space) -> np.ndarray:
    """An action of a space's shape, in or out of its bounds; ``InvalidAction`` for another."""
    found = np.asarray(action)
    if found.shape != space.shape:
        raise InvalidAction(f"action: shape {found.shape}; expected {space.shape}")
    return found


def info(moment: StepResult) -> dict[str, Any]:
    """What is known beside the observation, ``(n,)`` each: facts and terms by name, verdicts."""
    facts = {name: _array(fact) for name, fact in moment.facts.items()}
    return {
        "facts": facts,
        "terms": {name: _array(term) for name, term in moment.terms.items()},
        **{name: facts[name].copy() for name in ("success", "cheat") if name in facts},
        "potential": _array(moment.potential),
        "steps": _array(moment.steps),
    }


def row(values: dict[str, Any], env: int) -> dict[str, Any]:
    """One environment's part of ``info``, as plain values."""
    return {
        name: row(value, env) if isinstance(value, dict) else value[env].item()
        for name, value in values.items()
    }


def masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Batched ``info`` as Gymnasium gives it: ``_<name>`` says whose values are there, else 0."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            infos[name] = masked(value, mask)
        else:
            infos[name] = np.where(mask, value, np.zeros_like(value))
        infos[f"_{name}"] = mask.copy()
    return infos


def _array(tensor: Tensor) -> np.ndarray:
    """A copy, contiguous."""
    return np.array(tensor.cpu().numpy(), order="C")
