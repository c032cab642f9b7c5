"""``python -m wrongturn_client`` is the program ``wrongturn``."""

from wrongturn_client.cli import main

if __name__ == "__main__":
    main()
