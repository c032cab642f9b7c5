"""PPO in one file, in the manner of CleanRL, on Wrongturn's cars with the shipped curriculum.

The agent sees the privileged track, so it needs no GPU:

    python docs/examples/one_file_ppo.py --steps 1000000 --num-envs 64
"""

import argparse
import time

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from wrongturn_agents.training import DrivesConfig, training_cars

KEYS = ("speed", "steering", "command", "pose", "lane", "exits", "stop_line")
EVERY = 4
"""Metres between the points that the agent sees of the lane and of the commanded exit."""
WIDTH = 3 + 2 * 2 * 60 // EVERY
GAMMA, LAMBDA, CLIP, EPOCHS, BATCH = 0.97, 0.95, 0.2, 4, 1024


def arguments() -> argparse.Namespace:
    """Return the settings of the run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps of all cars together")
    parser.add_argument("--num-envs", type=int, default=64, help="cars side by side")
    parser.add_argument("--rollout", type=int, default=64, help="decisions of each car between two updates")
    parser.add_argument("--traffic", type=float, default=0.0, help="share of the drives beside other road users")
    parser.add_argument("--learning-rate", type=float, default=3e-4, help="Adam's learning rate at the start")
    parser.add_argument("--seed", type=int, default=1, help="seed of weights, drives and actions")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--save", default="one_file_ppo.pt", help="file for the weights")
    return parser.parse_args()


def seen(observation: dict[str, Tensor]) -> Tensor:
    """Return what the agent sees, (n, WIDTH): speed, steering, stop line, and points of its way in its own frame."""
    number = observation["command"][:, 0]
    exits = observation["exits"][torch.arange(len(number)), (number - 1).clamp(0, 2)]
    exits = torch.where((number <= 3)[:, None, None], exits, observation["lane"][:, -1:])
    x, y, yaw = observation["pose"].unbind(1)
    points = torch.cat([observation["lane"], exits], 1)[:, ::EVERY] - torch.stack([x, y], 1)[:, None]
    cos, sin = yaw.cos()[:, None], yaw.sin()[:, None]
    ahead = points[..., 0] * cos + points[..., 1] * sin
    left = points[..., 1] * cos - points[..., 0] * sin
    measured = torch.cat([observation["speed"] / 10, observation["steering"], observation["stop_line"] / 60], 1)
    return torch.cat([measured, ahead / 30, left / 30], 1).float()


class Agent(nn.Module):
    """A policy and a value."""

    def __init__(self) -> None:
        super().__init__()
        self.policy = nn.Sequential(nn.Linear(WIDTH, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, 2))
        self.value = nn.Sequential(nn.Linear(WIDTH, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, 1))
        self.log_std = nn.Parameter(torch.tensor([-1.5, -1.0]))
        with torch.no_grad():  # begin by driving ahead: brakes are stronger than the motor
            self.policy[-1].weight.mul_(0.01)
            self.policy[-1].bias.copy_(torch.tensor([0.0, 0.5]))

    def distribution(self, x: Tensor) -> Normal:
        """Return the distribution of steer and accelerate, (n, 2)."""
        return Normal(self.policy(x), self.log_std.exp())


def main() -> None:
    """Train, and save the weights."""
    args = arguments()
    torch.manual_seed(args.seed)
    cars = training_cars(
        args.num_envs, args.device, track="privileged", keys=KEYS, settings=DrivesConfig(traffic=args.traffic),
        seed=args.seed,
    )  # fmt: skip
    agent = Agent().to(args.device)
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, eps=1e-5)
    n, t, device = args.num_envs, args.rollout, args.device
    x = seen(cars.reset())
    ended = torch.zeros(n, device=device)
    steps, begin, returns = 0, time.monotonic(), []
    while steps < args.steps:
        optimizer.param_groups[0]["lr"] = args.learning_rate * (1 - steps / args.steps)
        xs, actions = torch.zeros(t, n, WIDTH, device=device), torch.zeros(t, n, 2, device=device)
        log_probs, rewards, values, ends = (torch.zeros(t, n, device=device) for _ in range(4))
        for i in range(t):
            xs[i], ends[i] = x, ended
            with torch.no_grad():
                chosen = agent.distribution(x)
                actions[i] = chosen.sample()
                log_probs[i] = chosen.log_prob(actions[i]).sum(1)
                values[i] = agent.value(x)[:, 0]
            observation, reward, done, infos = cars.step(actions[i].cpu().numpy())
            rewards[i], ended = torch.as_tensor(reward), torch.as_tensor(done, device=device).float()
            for k, info in enumerate(infos):
                if info:
                    returns.append(info["episode"]["r"])
                if "terminal_observation" in info:  # time ran out, so the drive would have gone on
                    last = {name: value[None] for name, value in info["terminal_observation"].items()}
                    with torch.no_grad():
                        rewards[i, k] += GAMMA * agent.value(seen(last))[0, 0]
            x = seen(observation)
            steps += n
        with torch.no_grad():
            following, lasting, advantage = agent.value(x)[:, 0], 1 - ended, torch.zeros(n, device=device)
        advantages = torch.zeros(t, n, device=device)
        for i in reversed(range(t)):
            delta = rewards[i] + GAMMA * following * lasting - values[i]
            advantage = advantages[i] = delta + GAMMA * LAMBDA * lasting * advantage
            following, lasting = values[i], 1 - ends[i]
        wanted = (advantages + values).flatten()
        flat = (xs.flatten(0, 1), actions.flatten(0, 1), log_probs.flatten(), advantages.flatten(), wanted)
        for _ in range(EPOCHS):
            for rows in torch.randperm(t * n, device=device).split(BATCH):
                some, action, before, gain, goal = (tensor[rows] for tensor in flat)
                ratio = (agent.distribution(some).log_prob(action).sum(1) - before).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                policy_loss = -torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = policy_loss + 0.5 * (agent.value(some)[:, 0] - goal).square().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        recent = sum(returns[-100:]) / max(1, len(returns[-100:]))
        print(
            f"{steps:,} steps, {steps / (time.monotonic() - begin):,.0f}/s, reward of a drive {recent:,.0f}", flush=True
        )
    cars.close()
    torch.save(agent.state_dict(), args.save)


if __name__ == "__main__":
    main()
