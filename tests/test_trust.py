"""A stranger's run or policy runs no code of its own, unless the person says ``trust=true``."""

import json
import shutil

import pytest
import torch
import yaml
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tiny_runs import PLACE, TINY, composed, refusal, run_composed

import needlehoop
from needlehoop.cli.main import main

EVIL = {
    "kind": "python",
    "function": "pydoc:pipepager",
    "values": {"text": "", "cmd": "touch {marker}"},
    "source": "",
    "name": None,
}


def evil(marker) -> dict:
    """A reward whose function would leave a file."""
    return json.loads(json.dumps(EVIL).replace("{marker}", str(marker)))


def test_a_policy_with_hostile_notes_runs_nothing(tiny_run, tmp_path):
    path, marker = tiny_run / "policy.safetensors", tmp_path / "ran"
    with safe_open(path, framework="pt") as file:
        senses, values = (json.loads(file.metadata()[name]) for name in ("senses", "config"))
    seen = {"signals": torch.rand(2, senses["vectors"]["signals"])}
    action, bad = needlehoop.load_policy(path)(seen), tmp_path / "policy.safetensors"
    hostile, task = evil(marker), tmp_path / "task"
    task.mkdir()
    (task / "__init__.py").write_text(f"open({str(marker)!r}, 'w')")
    network = {**senses["network"], "hidden": 16_384, "layers": 12}
    for sees, config, fits in (
        (senses, {**values, "reward": hostile}, True),
        (senses, {**values, "task": {"name": "task"}, "task_dir": str(task)}, True),
        ({**senses, "channels": hostile}, values, False),
        ({**senses, "function": "os:system"}, values, False),
        ({**senses, "image_size": 10**9}, values, False),
        ({**senses, "network": network}, values, False),
    ):
        save_file(load_file(path), bad, {"senses": json.dumps(sees), "config": json.dumps(config)})
        if fits:
            assert torch.equal(needlehoop.load_policy(bad)(seen), action)
        else:
            with pytest.raises(ValueError, match=str(bad)):
                needlehoop.load_policy(bad)
    assert not marker.exists()


@pytest.fixture
def stranger(tiny_run, tmp_path):
    """A run whose config was made to name a function that runs a shell command."""
    folder, marker = shutil.copytree(tiny_run, tmp_path / PLACE), tmp_path / "ran"
    values = yaml.safe_load((folder / "config.yaml").read_text())
    values["reward"] = evil(marker)
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
