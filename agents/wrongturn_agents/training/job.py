"""One job of a campaign, in a process of its own: train, score, and hand over what came of it.

``python -m wrongturn_agents.training.job DIRECTORY`` does what ``DIRECTORY/job.json`` says, or goes on with it.
"""

import ctypes
import json
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from wrongturn_agents.training.bundle import replace, split
from wrongturn_agents.training.campaign_plan import Job
from wrongturn_agents.training.checkpoint import load_checkpoint, read
from wrongturn_agents.training.display import Display
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lock import locked
from wrongturn_agents.training.score import score, summary, write_results
from wrongturn_agents.training.train import train

DONE = "done.json"
"""Of a run's directory: it was trained, scored and handed over."""
_TRAINED = "trained.json"


def run(folder: Path) -> None:
    """Do a job, from where it was interrupted.

    Raises:
        TrainingError: the job cannot be done.
    """
    told = json.loads((folder / "job.json").read_text("utf-8"))
    with locked(folder / ".lock", "another process is at this job"):
        _do(told, folder)


def _do(told: dict[str, Any], folder: Path) -> None:
    job = Job.of(told["job"])
    device, threads = told["device"], told["threads"]
    where = folder / "run"
    if not (folder / _TRAINED).is_file():
        _train(job, where, device, threads)
        replace(folder / _TRAINED, b"{}\n")
    bundle = Path(told["bundle"])
    keep(job, where, bundle)
    for suite in told["suites"]:
        file = folder / f"{suite}.json"
        if not file.is_file():
            begin = time.monotonic()
            results = score(where / "best.pt", suite, device=device, threads=threads)
            print("\n".join(summary(results)))
            print(f"{suite}: {len(results['trials'])} trials in {time.monotonic() - begin:.0f} s", flush=True)
            write_results(file, results)
        (bundle / "results").mkdir(parents=True, exist_ok=True)
        replace(bundle / "results" / f"{job.name}.{suite}.json", file.read_bytes())
    replace(folder / DONE, b"{}\n")


def keep(job: Job, where: Path, bundle: Path) -> None:
    """Hand over a run's curve, and its weights if it is the best of its algorithm so far."""
    curves = bundle / "runs" / job.name
    curves.mkdir(parents=True, exist_ok=True)
    for name in ("progress.csv", "config.json", "pretraining.json"):
        if (where / name).is_file():
            replace(curves / name, (where / name).read_bytes())
    evaluation = load_checkpoint(where / "best.pt")["evaluation"]
    replace(curves / "evaluation.json", (json.dumps(evaluation) + "\n").encode())
    if job.variant is None:
        manifest = bundle / "weights" / f"{job.algorithm}.json"
        manifest.parent.mkdir(parents=True, exist_ok=True)
        with locked(bundle / "weights" / f".{job.algorithm}.lock"):  # other seeds may be through at the same moment
            before = json.loads(manifest.read_text("utf-8"))["evaluation"] if manifest.is_file() else None
            if before is None or rank(evaluation) > rank(before):
                split(where / "best.pt", manifest.parent, job.algorithm)


def rank(evaluation: dict[str, Any]) -> tuple[float, int, float]:
    """By which the best seed is chosen: held-out success; among equals, the journeys that show it, then reward.

    Rewards compare among the same journeys alone: a brief evaluation has the shortest ones.
    """
    return evaluation.get("success", -1.0), evaluation.get("journeys", 0), evaluation.get("reward", 0.0)


def _train(job: Job, where: Path, device: str, threads: int) -> None:
    common: dict[str, Any] = {"directory": where, "device": device, "threads": threads}
    with Display(job.name) as display:
        common |= {"on_row": display.row, "on_pretraining": display.pretraining}
        if (where / "state.pt").is_file():
            train(job.algorithm, resume=True, **common)
            return
        options, encoder = list(job.options), where.with_name("encoder.pt")
        if (where / "encoder.pt").is_file():
            (where / "encoder.pt").replace(encoder)  # interrupted after its pretraining
        if encoder.is_file() and not job.encoder_of:
            options.append(f"encoder={encoder}")
        if job.encoder_of:
            shared = where.parent.parent / job.encoder_of
            found = [path for path in (shared / "run" / "encoder.pt", shared / "encoder.pt") if path.is_file()]
            if not found:
                raise TrainingError(f"{job.name}: encoder_of: {job.encoder_of} has no encoder.pt")
            read(found[0])
            options.append(f"encoder={found[0]}")
        if where.exists():
            shutil.rmtree(where)
        train(job.algorithm, seed=job.seed, steps=job.steps, minutes=job.minutes, options=options, **common)


def warm() -> None:
    """Compile what all jobs need, once, into the cache that they share."""
    import numpy as np  # noqa: PLC0415

    from wrongturn_sim import WrongturnVectorEnv  # noqa: PLC0415

    envs = WrongturnVectorEnv(4, "Town01", track="state", task="cruise", strict=True, record=False)
    envs.reset(seed=1)
    envs.step(np.zeros((4, 3), np.float32))
    envs.close()


def _end_with_parent() -> None:
    """Let nothing of a campaign that was killed go on: the next one would begin the same jobs."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


if __name__ == "__main__":
    _end_with_parent()
    if sys.argv[1:] == ["--warm"]:
        warm()
    else:
        run(Path(sys.argv[1]))
