"""Trained policies: a run's, a file's, and those of many camera sets as files for a release."""

from __future__ import annotations

import hashlib
import lzma
import re
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from needlehoop.learning.agent import Actor
from needlehoop.learning.evaluate import load_agent, told_policy, which_policy
from needlehoop.learning.job import Job, checked_job, pick_device
from needlehoop.learning.policy_spec import PolicySpec, check_same
from needlehoop.learning.weights import as_bfloat16, read_actor, read_spec
from needlehoop.runs.files import POLICIES, POLICY, csv_text, new_folder
from needlehoop.runs.run import Run
from needlehoop.study.data.records import Record, read_study
from needlehoop.study.stats.run import Final, final

AGENTS = Path("agents")
"""Where released agents are looked for, from the folder in which Python runs."""

_LARGEST = 2 << 20
"""Bytes of an agent's packed file, 2 MiB. In bfloat16 one of two cameras has 2.8 MB."""


def initial_weights(job: Job) -> dict[str, Tensor] | None:
    """The weights of the agent that a job is to begin with, that of the run ``job.init``, if any.

    Raises:
        ValueError: no such run, none trained yet, or one with other networks.
    """
    if job.init is None:
        return None
    run = Run.open(Path(job.init), "init")
    theirs = checked_job(run.config())
    # The order of cameras and which facts are told count as well.
    for key in ("cams", "obs"):
        own, other = getattr(theirs.env, key), getattr(job.env, key)
        if own != other:
            raise ValueError(f"init: {run.folder} has {key}={own}; this run has {other}")
    # Their weights replace the first deviation.
    have, want = (
        replace(one.spec, precision="", network=replace(one.network, sigma=1.0))
        for one in (theirs, job)
    )
    check_same(have, want, f"init: {run.folder}")
    which, _ = which_policy(run, None)
    return load_agent(run, theirs, torch.device("cpu"), which).state_dict()


def actor_in(
    run: str | Path, device: str, policy: str | None = None, precision: str | None = None
) -> tuple[PolicySpec, Actor, str]:
    """What a run's policy sees, the policy, and which it is in words.

    It is read from its file, and the last one from the checkpoint where it has no file. Arguments
    as in ``needlehoop.load_policy``.

    Args:
        precision: of the convolutions; ``None``: the run's.

    Raises:
        ValueError: nothing there, a damaged file, or as in ``which_policy``.
    """
    where, chosen = _released(run), pick_device(device)
    weights, origin = where, str(where)
    if where.is_dir():
        which, steps = which_policy(Run(where), policy)
        weights, origin = where / POLICIES[which], f"{told_policy(which, steps)}, of {where}"
    elif policy is not None:
        raise ValueError(f"policy: {where} is a policy already; choose one of a run's folder")
    other = {} if precision is None else {"precision": precision}
    if where.is_dir() and not weights.exists():
        opened = Run.open(where)
        job = replace(checked_job(opened.config()), **other)
        return job.spec, load_agent(opened, job, chosen).actor, origin
    spec = replace(read_spec(weights), **other)
    return spec, read_actor(weights, spec, chosen), origin


def _released(run: str | Path) -> Path:
    """The file of a released agent, for camera names that are no path; else the path.

    Raises:
        ValueError: no agent of these cameras has been unpacked.
    """
    name = str(run)
    if Path(run).exists() or not re.fullmatch(r"\w+_\w+([+,]\w+_\w+)*", name):
        return Path(run)
    cams = re.split("[+,]", name)
    # The unpacked one before the packed one.
    for path in sorted(AGENTS.glob("*.safetensors*")):
        if sorted(path.name.partition(".")[0].split("+")) == sorted(cams):
            if path.suffix == ".xz":
                raise ValueError(f"run: {path} is packed; unpack it with: xz --decompress {path}")
            return path
    raise ValueError(
        f"run: {name!r} is no folder, and {AGENTS}/ has no agent of these cameras; put the"
        f" released ones there, or train one in four minutes: python train.py algo=dagger"
        f" cams={','.join(cams)}"
    )


def pack(study: Path, out: Path) -> list[Path]:
    """Write the agent of each camera set of a study: ``<cameras>.safetensors.xz``, in bfloat16.

    Of several runs of one set the most successful is taken, of equal ones the first seed's. Beside
    the agents stand what they can do (``agents.csv``) and checksums (``SHA256SUMS``).

    Args:
        out: a folder that is not there yet; it is written whole or not at all.

    Returns:
        The files.

    Raises:
        ValueError: no such study, no policy in it, a damaged or too large one, or ``out`` exists.
    """
    if out.exists():
        raise ValueError(f"--out: {str(out)!r} exists; choose another folder")
    best: dict[str, tuple[Final, Record]] = {}
    for run in read_study(study).runs:
        end = final(run)
        if end is None or not end.finished or not (run.folder / POLICY).exists():
            continue
        if run.place.cameras not in best or end.success > best[run.place.cameras][0].success:
            best[run.place.cameras] = end, run
    if not best:
        raise ValueError(f"{study}: no finished run has a {POLICY}")
    files, rows = {}, []
    for cameras, (end, run) in sorted(best.items()):
        content = lzma.compress(as_bfloat16(run.folder / POLICY), preset=9 | lzma.PRESET_EXTREME)
        if len(content) > _LARGEST:
            raise ValueError(
                f"{run.folder / POLICY} takes {len(content):,} bytes, packed; a released agent may"
                f" have {_LARGEST:,}"
            )
        files[f"{cameras}.safetensors.xz"] = content
        where = (run.task.name, run.place.reward, run.place.seed)
        rows.append((cameras, *where, end.success, end.episodes, run.manifest.get("commit")))
    header = ("cameras", "task", "reward", "seed", "success", "episodes", "commit")
    files["agents.csv"] = csv_text(header, rows).encode()
    sums = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in files.items())
    files["SHA256SUMS"] = "".join(sums).encode()
    with new_folder(out, overwrite=False) as folder:
        for name, data in files.items():
            (folder / name).write_bytes(data)
    return [out / name for name in files]
