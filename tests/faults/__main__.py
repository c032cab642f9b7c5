"""The whole of it by hand: ``.venv/bin/python tests/faults --kills 100 --seed 3 --database sqlite postgresql``."""

import argparse
import math
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from campaign import Report, run
from databases import File, server
from moments import ALL, NO_SERVER, moments
from summary import show


def main() -> int:
    """Kill on each database, print the table; 1 where anything was lost, doubled or bent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="on each database")
    parser.add_argument("--seed", type=int, default=3, help="of the moments")
    parser.add_argument("--database", nargs="+", choices=("sqlite", "postgresql"), default=["sqlite", "postgresql"])
    parser.add_argument("--minutes", type=float, default=math.inf, help="after which nothing more is killed")
    parser.add_argument("--logs", type=Path, help="a folder for logs and journals; else they are gone")
    given = parser.parse_args()
    longest_s = 60 * given.minutes
    reports: list[Report] = []
    for database in given.database:
        with tempfile.TemporaryDirectory(prefix="wt-faults-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            folder.chmod(0o755)
            logs = folder if given.logs is None else given.logs / database
            logs.mkdir(parents=True, exist_ok=True)
            if database == "sqlite":
                reports.append(
                    run(File(folder), logs, moments(given.seed, given.kills, NO_SERVER), longest_s=longest_s)
                )
            else:
                with server(folder) as store:
                    reports.append(run(store, logs, moments(given.seed, given.kills, ALL), longest_s=longest_s))
        # What is done is told, whatever becomes of the next.
        show(reports)
    for report in reports:
        for kind, found in report.findings.bad.items():
            print(f"{report.database}: {kind}:", *found, sep="\n  ")
    return int(any(report.findings.bad for report in reports))


if __name__ == "__main__":
    sys.exit(main())
