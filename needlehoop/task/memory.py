"""What the task remembers between steps."""

from __future__ import annotations

import torch
from tensordict import TensorClass
from torch import Tensor

from needlehoop.task.episode import Episode
from needlehoop.task.reach import tool_quat
from needlehoop.task.start import Start


class State(TensorClass):
    """What the task remembers between steps.

    ``target`` ``(n, 3)`` for ``tool_midpoint``, m; ``tool_roll`` ``(n,)`` about the instrument,
    rad; ``quat`` ``(n, 4)`` of the tool frame (``control=pose``); ``joints`` ``(n, 6)`` and
    ``jaw`` ``(n,)`` as commanded; latched facts; ``steps`` ``(n,)`` taken.
    """

    target: Tensor
    tool_roll: Tensor
    quat: Tensor
    joints: Tensor
    jaw: Tensor
    grasped: Tensor
    lifted: Tensor
    has_grasped: Tensor
    has_touched: Tensor
    steps: Tensor


def begin(episode: Episode, begun: Start) -> State:
    """The task's memory at the start of an episode: targets where the tool is."""
    n = len(begun.jaw)
    no = torch.zeros(n, dtype=torch.bool)
    return State(
        target=begun.tool.clone(),
        tool_roll=begun.joints[:, 3].clone(),
        quat=tool_quat(begun.joints) if episode.control == "pose" else torch.zeros(n, 4),
        joints=begun.joints.clone(),
        jaw=begun.jaw.clone(),
        grasped=no,
        lifted=no.clone(),
        has_grasped=no.clone(),
        has_touched=no.clone(),
        steps=torch.zeros(n, dtype=torch.int64),
        batch_size=[n],
    )
