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
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.job import typed_job
from needlehoop.learning.networks import Actor, HeadConfig, PolicySpec
from needlehoop.learning.policy import write_weights
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
        Actor(senses, senses.trunk(torch.device("cpu"))),
        values,
        "float32",
    )
    return folder / "policy.safetensors", asdict(senses), values


def is_ours(event, what):
    """Whether Python reads a type of our own dataclasses, which are texts, for an error."""
    kinds = (PolicySpec, EncoderConfig, HeadConfig)
    types = {str(text.encode()) for kind in kinds for text in kind.__annotations__.values()}
    return (event == "compile" and what in types) or (event == "exec" and '"<string>"' in what)


def test_a_policy_with_hostile_notes_runs_nothing(policy, tmp_path):
    path, senses, values = policy
    state = load_file(path)
    seen = {"rgb_front": torch.randint(0, 255, (2, 3, 32, 32), dtype=torch.uint8)}
    action, bad = needlehoop.load_policy(path)(seen), tmp_path / "policy.safetensors"
    network = {**senses["network"], "hidden": 16_384, "layers": 12}
    for sees, config, fits in (
        (senses, {**values, "reward": EVIL}, True),
        (senses, {**values, "reward": {"_target_": "os.system"}}, True),
        (senses, {**values, "task": {"name": "os"}, "task_dir": "/tmp"}, True),
        ({**senses, "cams": EVIL}, values, False),
        ({**senses, "function": "os:system"}, values, False),
        ({**senses, "image_size": 10**9}, values, False),
        ({**senses, "network": network}, values, False),
    ):
        save_file(state, bad, {"senses": json.dumps(sees), "config": json.dumps(config)})
        with audited() as events:
            try:
                loaded = needlehoop.load_policy(bad)
            except ValueError:
                loaded = None
        assert {one for one in events if one != ("open", str(bad)) and not is_ours(*one)} == set()
        assert fits == (loaded is not None and torch.equal(loaded(seen), action))


def test_the_audit_sees_what_it_looks_for():
    with audited() as events:
        exec("open('/dev/null').close()")
    assert {event for event, _ in events} >= {"open", "exec"}


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
        ["demonstrations", f"demonstrator={folder}", f"out={tmp_path}/demos-v0", "seed=9"],
    ):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert "'pydoc:pipepager'" in error
        assert "trust=true" in error
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


def test_a_run_of_one_s_own_function_goes_on_with_trust(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def pay(signals):\n    return {'jaw': signals.jaw}\n")
    words = [word for word in TINY if not word.startswith("reward=")]
    overrides = ["cams=[]", "reward=python", "reward.function=mine.py:pay", f"results={tmp_path}"]
    values = composed(*words, *overrides)
    run_composed({**values, "until": 8})
    folder = tmp_path / "main/signals/python/seed0"
    # It is found from wherever one goes on.
    monkeypatch.chdir("/")
    capsys.readouterr()
    assert "trust=true" in refusal(f"resume={folder}")
    run_composed({**values, "resume": str(folder), "trust": True, "until": 16})
    # The same command line is trust enough: it names the function itself.
    monkeypatch.chdir(tmp_path)
    run_composed({**values, "existing": "resume"})
    assert json.loads((folder / "manifest.json").read_text())["finished"]
    assert main(["evaluate", str(folder), "episodes=1", "trust=true"]) == 0


def test_a_config_from_a_file_is_never_loaded():
    config = {"kind": "python", "function": "os:system", "values": {}, "source": None}
    rewards.check(config, TASK)
    with pytest.raises(ValueError, match="trust=true"):
        load_reward(config)
