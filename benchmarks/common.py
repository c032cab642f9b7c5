"""What all benchmarks share: two options, the load beside the figures, and the processor time of another process."""

import argparse
import json
import os
from pathlib import Path
from typing import Any


def parser(about: str | None) -> argparse.ArgumentParser:
    """A benchmark's options; ``--short`` is what the tests run."""
    made = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--short", action="store_true", help="as little as shows that it works; the figures mean nothing")
    made.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    return made


def finish(figures: dict[str, Any], options: argparse.Namespace) -> None:
    """Print the load of the machine, which spoils figures, and write the file that was asked for."""
    load = os.getloadavg()
    print(f"load {load[0]:.1f} on {os.cpu_count()} cores")
    if options.json is not None:
        content = {**figures, "load": load, "cores": os.cpu_count(), "short": options.short}
        options.json.write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def processor_s(pid: int) -> float:
    """Seconds of processor time of a process, all its threads."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / 1e9
