"""How fast the learner is on a device, on frames that are made up.

    python benchmarks/learner.py device=cuda

The words are settings of ``python train.py``. Nothing is simulated: a buffer of random frames is
learnt from again and again, by PPO with three sizes of minibatches, by imitation and by SAC.
"""

import sys
import time

import torch
from tensordict import TensorDict

from needlehoop.config import composing
from needlehoop.learning.encoder import Fold
from needlehoop.learning.job import Job, typed_job
from needlehoop.learning.learner import ALGORITHMS, build_agent

CASES = {
    "ppo, minibatches of 256": ["algo.minibatch=256"],
    "ppo, minibatches of 1,024": ["algo.minibatch=1024"],
    "ppo, minibatches of 4,096": ["algo.minibatch=4096"],
    "imitation": ["algo=dagger"],
    "sac": ["algo=sac", "algo.memory=20_000"],
}


def buffer_of(job: Job) -> TensorDict:
    """A buffer ``(num_envs, horizon)`` of noise, on the learner's device."""
    device, steps = job.torch_device, job.buffer // job.env.num_envs
    shape = (job.env.num_envs, steps)

    def seen() -> dict:
        fold = Fold(job.encoder.stem)
        images = {
            name: fold(torch.randint(0, 256, (*shape, *size), dtype=torch.uint8))
            for name, size in job.spec.images.items()
        }
        facts = {name: torch.rand(*shape, 1) < 0.5 for name in job.env.definition.all_facts}
        return {"pixels": images, "facts": facts}

    no, column = torch.zeros(*shape, 1, dtype=torch.bool), torch.randn(*shape, 1)
    ends = {"done": no, "terminated": no.clone(), "truncated": no.clone(), "reward": column}
    size = job.spec.actions
    action, still = torch.rand(*shape, size) * 2 - 1, torch.zeros(*shape, size)
    policy = {"action": action, "label": action, "expert": action, "learner": no.clone()}
    policy |= {"loc": still, "scale": still + 0.6, "action_log_prob": column[..., 0] * 0 - 4.0}
    made = {**seen(), **policy, "state_value": column * 0, "next": {**seen(), **ends}}
    return TensorDict(made, shape).to(device)


def rate(words: list[str], rounds: int = 3) -> float:
    """Steps per second that are learnt from; the first buffer warms up."""
    job = typed_job(composing.compose(words, "job"))
    torch.manual_seed(0)
    kind = ALGORITHMS[job.algo.kind]
    algorithm = kind(build_agent(job, job.torch_device), job.algo, rounds + 1, 0)
    buffer, times = buffer_of(job), []
    for _ in range(rounds + 1):
        began = time.perf_counter()
        algorithm.update(buffer.clone())
        if job.torch_device.type == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - began)
    return job.buffer / min(times[1:])


if __name__ == "__main__":
    cams = (
        [] if any(word.startswith("cams=") for word in sys.argv) else ["cams=[dep_front,seg_side]"]
    )
    for name, words in CASES.items():
        print(f"{name}: {rate([*words, *cams, *sys.argv[1:]]):,.0f} steps/s", flush=True)
