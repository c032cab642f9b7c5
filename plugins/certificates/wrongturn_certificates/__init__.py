"""Checks of the certificates that Wrongturn's services sign. It knows nothing of the service that made one."""
