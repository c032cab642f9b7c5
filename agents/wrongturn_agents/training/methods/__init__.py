"""The shipped training methods, one a folder. Each is registered as an entry point of ``wrongturn.methods``."""
