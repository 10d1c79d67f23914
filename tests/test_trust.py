"""A stranger's run or policy runs no code of its own, unless the person says ``trust=true``."""

import json
import shutil
import sys
from contextlib import contextmanager
from dataclasses import asdict

import pytest
import torch
import yaml
from needle_task import load_reward
from safetensors.torch import load_file, save_file
from tiny_runs import PLACE, TINY, composed, refusal, run_composed

import needlehoop
from needlehoop import rewards
from needlehoop.cli.main import main
from needlehoop.learning.agent import build_actor
from needlehoop.learning.job import typed_job
from needlehoop.learning.weights import write_weights
from needlehoop.tasks.needle_hoop import TASK

EVIL = {
    "kind": "python",
    "function": "pydoc:pipepager",
    "values": {"text": "", "cmd": "touch {marker}"},
    "source": "",
    "name": None,
}

EVENTS = ("import", "exec", "compile", "open", "subprocess", "os.", "socket", "shutil", "ctypes")
"""Audit events, or how their names begin, that code of a stranger would need."""

_watching: list[tuple[str, str]] | None = None


def _hook(event, args):
    if _watching is not None and event.startswith(EVENTS):
        _watching.append((event, str(args[0]) if args else ""))


sys.addaudithook(_hook)


@contextmanager
def audited():
    """What Python was asked to import, run or open inside the block."""
    global _watching
    _watching = seen = []
    try:
        yield seen
    finally:
        _watching = None


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy's file, what it says that it sees, and its run's config."""
    words = ["cams=[rgb_front]", "image_size=32", "precision=fp32", "algo.network.hidden=8"]
    values = composed(*words)
    folder = tmp_path_factory.mktemp("policy")
    torch.manual_seed(0)
    senses = typed_job(values).spec
    write_weights(
        folder / "policy.safetensors",
        senses,
        build_actor(senses, torch.device("cpu")),
        values,
        "float32",
    )
    return folder / "policy.safetensors", asdict(senses), values


def hostile(senses, values, marker):
    """Notes that name code or sizes without end; and whether the policy is still one."""
    evil = json.loads(json.dumps(EVIL).replace("{marker}", str(marker)))
    for reward in (evil, {**evil, "source": None}, {**evil, "call": "os:system"}):
        yield "reward", senses, {**values, "reward": reward}, True
    yield "entry point", senses, {**values, "reward": {"kind": "mine", "function": "os:x"}}, True
    yield "target", senses, {**values, "reward": {"_target_": "os.system"}}, True
    yield "task", senses, {**values, "task": {"name": "os"}, "task_dir": "/tmp"}, True
    yield "no config", senses, {}, True
    for key in senses:
        for bad in (evil, "os:system", [evil], None, 1e300, {"../..": 3}):
            yield f"{key} {bad}", {**senses, key: bad}, values, key == "control" and bad in FITS
        yield f"no {key}", {k: v for k, v in senses.items() if k != key}, values, False
    yield "large", {**senses, "image_size": 10**9}, values, False
    yield "deep", {**senses, "network": {**senses["network"], "layers": 64}}, values, False
    yield "extra", {**senses, "function": "os:system"}, values, False


FITS = ("os:system",)
"""A name of a control mode is for people: nothing looks it up."""


def test_a_policy_with_hostile_notes_runs_nothing(policy, tmp_path):
    path, senses, values = policy
    state = load_file(path)
    seen = {"rgb_front": torch.randint(0, 255, (2, 3, 32, 32), dtype=torch.uint8)}
    action = needlehoop.load_policy(path)(seen)
    bad, marker = tmp_path / "policy.safetensors", tmp_path / "ran"
    for notes in ({"config": json.dumps(values)}, {"senses": "{}"}, {"senses": "["}):
        save_file(state, bad, notes)
        with pytest.raises(ValueError, match=r"policy\.safetensors"):
            needlehoop.load_policy(bad)
    for name, sees, config, fits in hostile(senses, values, marker):
        save_file(state, bad, {"senses": json.dumps(sees), "config": json.dumps(config)})
        found = said = None
        with audited() as asked:
            try:
                found = needlehoop.load_policy(bad)
            except ValueError as error:
                said = str(error)
        assert said is None or "\n" not in said, name
        assert {one for one in asked if one != ("open", str(bad))} == set(), name
        assert (found is not None) == fits, (name, said)
        if found is not None:
            assert torch.equal(found(seen), action), name
    assert not marker.exists()


def test_the_shipped_policy_loads_whatever_it_computes_in():
    assert callable(needlehoop.load_policy())


def test_the_audit_sees_what_it_looks_for():
    with audited() as asked:
        exec("open('/dev/null').close()")
    assert {event for event, _ in asked} >= {"open", "exec"}


@pytest.fixture
def stranger(tiny_run, tmp_path):
    """A run whose config was made to name a function that runs a shell command."""
    folder, marker = shutil.copytree(tiny_run, tmp_path / PLACE), tmp_path / "ran"
    values = yaml.safe_load((folder / "config.yaml").read_text())
    values["reward"] = json.loads(json.dumps(EVIL).replace("{marker}", str(marker)))
    (folder / "config.yaml").write_text(yaml.safe_dump(values))
    return folder, marker


def test_no_command_imports_what_a_run_names(stranger, tmp_path, capsys):
    folder, marker = stranger
    for words in (
        ["evaluate", str(folder)],
        ["watch", str(folder), "window=false", f"out={tmp_path}/film.mp4"],
        ["demonstrations", f"demonstrator={folder}", f"out={tmp_path}/demos-v0", "seed=9"],
    ):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert "'pydoc:pipepager'" in said
        assert "trust=true" in said
    with pytest.raises(ValueError, match="trust=true"):
        needlehoop.make_env_of(folder)
    (folder / "manifest.json").write_text("{}")
    assert "trust=true" in refusal(f"resume={folder}")
    # Its policy can be had all the same, and its episodes be judged by a reward of ours.
    assert callable(needlehoop.load_policy(folder))
    assert main(["evaluate", str(folder), "reward=human", "episodes=1"]) == 0
    assert not marker.exists()


def test_trust_needs_the_source_and_compares_it(stranger, capsys):
    folder, marker = stranger
    assert main(["evaluate", str(folder), "trust=true"]) == 2
    assert "no longer what the run began with" in capsys.readouterr().err
    values = yaml.safe_load((folder / "config.yaml").read_text())
    values["reward"]["source"] = None
    (folder / "config.yaml").write_text(yaml.safe_dump(values))
    assert main(["evaluate", str(folder), "trust=true"]) == 2
    assert "reward.source: null" in capsys.readouterr().err
    assert not marker.exists()


def test_a_run_of_one_s_own_function_goes_on_with_trust(tmp_path, capsys):
    file = tmp_path / "mine.py"
    file.write_text("def pay(signals):\n    return {'jaw': signals.jaw}\n")
    words = [word for word in TINY if not word.startswith("reward=")]
    own = ["cams=[]", "reward=python", f"reward.function={file}:pay", f"results={tmp_path}"]
    values = composed(*words, *own)
    run_composed({**values, "until": 8})
    folder = tmp_path / "main/signals/python/seed0"
    capsys.readouterr()
    assert "trust=true" in refusal(f"resume={folder}")
    # The same command line is trust enough: it names the function itself.
    run_composed({**values, "until": 16, "existing": "resume"})
    run_composed({**values, "resume": str(folder), "trust": True})
    assert json.loads((folder / "manifest.json").read_text())["finished"]
    assert main(["evaluate", str(folder), "episodes=1", "trust=true"]) == 0


def test_a_config_from_a_file_is_never_loaded():
    plain = {"kind": "python", "function": "os:system", "values": {}, "source": None}
    for config_ in (plain, {**plain, "call": "os:system"}):
        rewards.check(config_, TASK)
        with pytest.raises(ValueError, match="trust=true"):
            load_reward(config_)
