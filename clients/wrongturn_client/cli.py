"""The program ``wrongturn``."""


def main() -> None:
    """Run it."""
