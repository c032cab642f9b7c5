"""The first tables. New databases are made from the models; those of earlier versions are refused: nobody had one."""

revision = "0011"
down_revision = None


def upgrade() -> None:
    """Change nothing. The next migration begins here."""
