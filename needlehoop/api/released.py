"""Trained agents of many camera sets as files for a release, and one of them by its cameras."""

from __future__ import annotations

import hashlib
import lzma
import re
from pathlib import Path
from tempfile import TemporaryDirectory

from needlehoop.learning.weights import as_bfloat16
from needlehoop.runs.files import POLICY, csv_text
from needlehoop.study.data.records import Record, read_study
from needlehoop.study.stats.run import Final, final

AGENTS = Path("agents")
"""Where released agents are looked for, from the folder in which Python runs."""

SUMS, TABLE = "SHA256SUMS", "agents.csv"

_LARGEST = 2 << 20
"""Bytes of an agent's packed file, 2 MiB. In bfloat16 one of two cameras has 2.8 MB."""

_CAMERAS = re.compile(r"\w+_\w+([+,]\w+_\w+)*")


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
    files[TABLE] = csv_text(header, rows).encode()
    sums = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in files.items())
    files[SUMS] = "".join(sums).encode()
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside:
        fresh = Path(beside) / "fresh"
        fresh.mkdir()
        for name, data in files.items():
            (fresh / name).write_bytes(data)
        fresh.rename(out)
    return [out / name for name in files]


def released(run: str | Path) -> str | Path:
    """The file of a released agent, for camera names that are no path; anything else as it is.

    Raises:
        ValueError: no agent of these cameras has been unpacked.
    """
    name = str(run)
    if Path(name).exists() or not _CAMERAS.fullmatch(name):
        return run
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
