"""Whether Stable-Baselines3's loop is what limits training: it against a plain loop that does the same work.

Both drive the same environments by the same policy and learn by the same loss from rollouts of the same size, in turns
in one process, so that a busy machine is busy for both. The plain loop has no callbacks and no infos of episodes: it
goes from tensor to tensor, and bootstraps all drives whose time ran out at once. Where the time goes in
Stable-Baselines3's loop is told beside it; ``rest`` is what is neither environments, policy, buffer nor learning.

The defaults are for a GPU, where they take a minute or two and as much memory as two runs:

    python benchmarks/training_loop.py [--algorithm ppo-segmentation] [--device cuda] [--rollouts 4] [--repeats 3]
        [--option name=value]... [--json FILE]

On two idle cores this takes a minute:

    python benchmarks/training_loop.py --device cpu --rollouts 2 --repeats 3 --option num_envs=32
"""

import copy
import os
import statistics
import time
from typing import Any

import numpy as np
import torch
from common import finish, parser

from wrongturn_agents.models import build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import training_cars
from wrongturn_agents.training.method import find_method
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.rollout import SeenVecEnv


def made(algorithm: str, device: torch.device, threads: int, options: list[str]) -> WrongturnPPO:
    """An untrained agent and its environments, as a run begins with them."""
    config = find_method(algorithm).settings().with_options(options)
    agent = build(algorithm, seed=1).to(device)
    envs = SeenVecEnv(training_cars(None, device, settings=config, threads=threads), agent, config)
    return WrongturnPPO(config, envs, agent, Budget(10**9, None), seed=1, device=device)


def watched(ppo: WrongturnPPO, device: torch.device) -> dict[str, float]:
    """Count the seconds of each part of Stable-Baselines3's loop from now on, in what is returned."""
    seconds: dict[str, float] = {}

    def watch(owner: Any, method: str, part: str) -> None:
        work = getattr(owner, method)

        def counted(*arguments: Any, **options: Any) -> Any:
            found: list[Any] = []
            took = timed(lambda: found.append(work(*arguments, **options)), device)
            seconds[part] = seconds.get(part, 0.0) + took
            return found[0]

        setattr(owner, method, counted)

    watch(ppo.env, "step", "env")
    watch(ppo.policy, "forward", "policy")
    watch(ppo.rollout_buffer, "add", "buffer")
    watch(ppo, "train", "learn")
    return seconds


class PlainLoop:
    """The same work without Stable-Baselines3 around it."""

    def __init__(self, ppo: WrongturnPPO) -> None:
        self.ppo = ppo
        self.seen: dict[str, torch.Tensor] | None = None
        self.begun = np.ones(ppo.n_envs, np.bool_)

    def rollout(self) -> None:
        ppo = self.ppo
        policy, buffer, config = ppo.policy, ppo.rollout_buffer, ppo.config
        policy.model.eval()
        buffer.reset()
        if self.seen is None:
            self.seen = ppo.env.reset()
        for _ in range(config.n_steps):
            with torch.no_grad():
                mean, values = policy.model(policy.features(self.seen), self.seen["command"])
                actions = mean + policy.model.log_std.exp() * torch.randn_like(mean)
                log_prob = policy._log_prob(mean, actions)
            following, rewards, dones, infos = ppo.env.step(actions.cpu().numpy())
            late = [i for i in np.flatnonzero(dones).tolist() if "terminal_observation" in infos[i]]
            if late:
                last = [infos[i]["terminal_observation"] for i in late]
                with torch.no_grad():
                    ends = policy.predict_values({name: torch.stack([one[name] for one in last]) for name in last[0]})
                rewards[late] += config.gamma * ends.cpu().numpy()
            buffer.add(self.seen, actions, rewards, self.begun, values, log_prob)
            self.seen, self.begun = following, dones
        with torch.no_grad():
            buffer.compute_returns_and_advantage(policy.predict_values(self.seen), dones)

    def update(self) -> None:
        ppo = self.ppo
        policy, config = ppo.policy, ppo.config
        policy.model.train()
        copy.deepcopy((policy.state_dict(), policy.optimizer.state_dict()))  # so that theirs can undo the update
        parameters = [parameter for group in policy.optimizer.param_groups for parameter in group["params"]]
        for _ in range(config.n_epochs):
            for samples in ppo.rollout_buffer.get(config.batch_size):
                loss, _, divergence = ppo._loss(samples)
                divergence.item()  # which theirs looks at, to stop by it
                policy.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                torch.nn.utils.clip_grad_norm_(parameters, config.max_grad_norm)
                policy.optimizer.step()
        ppo._final_divergence()

    def run(self, rollouts: int) -> None:
        for _ in range(rollouts):
            self.rollout()
            self.update()


def timed(work: Any, device: torch.device) -> float:
    begin = time.perf_counter()
    work()
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - begin


def main() -> None:
    options_of = parser(__doc__)
    options_of.add_argument("--algorithm", default="ppo-segmentation")
    options_of.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options_of.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    options_of.add_argument("--rollouts", type=int, default=4)
    options_of.add_argument("--repeats", type=int, default=3)
    options_of.add_argument("--option", action="append", default=[])
    arguments = options_of.parse_args()
    if arguments.short:
        arguments.rollouts = arguments.repeats = 1
        arguments.option += ["num_envs=2", "n_steps=8"]
    device = torch.device(arguments.device)
    if device.type == "cpu":
        torch.set_num_threads(arguments.threads)
    else:  # as a run has it
        torch.backends.cudnn.benchmark = True
        torch.set_float32_matmul_precision("high")
    # No update is stopped early by its divergence, nor undone: so both learn equally often.
    options = ["learning_rate=1e-7", "kl_stop=1e9", *arguments.option]
    theirs, plain = (made(arguments.algorithm, device, arguments.threads, options) for _ in range(2))
    steps = arguments.rollouts * theirs.config.n_steps * theirs.config.num_envs
    loop = PlainLoop(plain)
    theirs.learn(1, log_interval=None)  # compiles, allocates
    loop.run(1)
    rates: dict[str, list[float]] = {"stable_baselines3": [], "plain": []}
    parts, whole = watched(theirs, device), 0.0
    for _ in range(arguments.repeats):
        seconds = timed(lambda: theirs.learn(steps, log_interval=None, reset_num_timesteps=False), device)
        rates["stable_baselines3"].append(steps / seconds)
        whole += seconds
        rates["plain"].append(steps / timed(lambda: loop.run(arguments.rollouts), device))
    found = {name: statistics.median(values) for name, values in rates.items()}
    print(f"{arguments.algorithm} on {device}, {theirs.config.num_envs} egos, {steps:,} steps a turn")
    for name, rate in found.items():
        print(f"  {name:18} {rate:10,.0f} steps/s (median of {arguments.repeats})")
    print(f"  the plain loop is faster by {found['plain'] / found['stable_baselines3'] - 1:.0%}")
    parts["rest"] = whole - sum(parts.values())
    shares = {part: value / whole for part, value in sorted(parts.items(), key=lambda item: -item[1])}
    print("  " + ", ".join(f"{part} {share:.0%}" for part, share in shares.items()))
    finish({"algorithm": arguments.algorithm, "device": str(device), "rates": rates, "shares": shares}, arguments)


if __name__ == "__main__":
    main()
