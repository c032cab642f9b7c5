"""What a campaign came to, as a table."""

from campaign import Report
from rich.console import Console
from rich.table import Table


def show(reports: list[Report]) -> None:
    """Print it."""
    table = Table(title="Killed by SIGKILL while evaluations went on")
    table.add_column("")
    for report in reports:
        table.add_column(report.database, justify="right")

    def line(name: str, *values: object) -> None:
        table.add_row(name, *map(str, values))

    victims = sorted({victim for report in reports for victim in report.kills})
    line("kills", *(report.kills.total() for report in reports))
    for victim in victims:
        line(f"  {victim}", *(report.kills[victim] for report in reports))
    table.add_section()
    line("evaluations", *(report.findings.evaluations for report in reports))
    line("episodes with a verdict", *(report.findings.finished for report in reports))
    line("last replies acknowledged", *(report.findings.acknowledged for report in reports))
    line("clients that gave up and came again", *(report.gave_up.total() for report in reports))
    line("replays in another simulator", *(report.replays for report in reports))
    line("gone on with by the next client", *(report.gone_on_with for report in reports))
    line("voided and driven again", *(report.findings.voided.total() for report in reports))
    table.add_section()
    for name in ("lost", "twice", "cut_off", "differing", "unfinished", "unexplained", "damaged"):
        line(name.replace("_", " "), *(len(getattr(report.findings, name)) for report in reports))
    table.add_section()
    line("seconds", *(f"{report.seconds:.0f}" for report in reports))
    Console(width=100).print(table)
    for report in reports:
        told = {"refused": report.refusals, "gave up": report.gave_up, "voided": report.findings.voided}
        for name, found in told.items():
            Console(width=100).print(f"{report.database}: {name}: {dict(found) or 'none'}")
