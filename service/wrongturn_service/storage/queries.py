"""What all groups of queries share."""

from wrongturn_service.storage.database import Database
from wrongturn_service.storage.usage import Quota, Usage


class Queries:
    """Queries on a database. Each method is one transaction."""

    def __init__(self, database: Database, quota: Quota | None = None) -> None:
        """Use a database.

        Args:
            database: The database.
            quota: What owners and addresses may have. None for no limits.
        """
        self._database = database
        self._usage = Usage(quota)
