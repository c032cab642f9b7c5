"""Steps a second of MetaDrive's state environment and of highway-env's grayscale one, in this process."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium

sys.path.insert(0, str(Path(__file__).parent.parent))
from frames import highway, metadrive


def rate(step: Any, seconds: float) -> float:
    """``step`` tells the processor seconds of a step, its resets left out."""
    spent, begin = [], time.perf_counter()
    while time.perf_counter() < begin + seconds:
        spent.append(step())
    return len(spent) / sum(spent)


def main() -> None:
    rounds, seconds = int(sys.argv[1]), float(sys.argv[2])
    found: dict[str, Any] = {}
    for make in (lambda: metadrive("state"), highway):
        try:
            steps = {name: step for name, step in make().items() if name.startswith("step")}
        except (Exception, gymnasium.error.Error) as error:
            found.setdefault("absent", []).append(f"{type(error).__name__}: {error}"[:200])
            continue
        for name, step in steps.items():
            found[name] = [rate(step, seconds) for _ in range(rounds)]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
