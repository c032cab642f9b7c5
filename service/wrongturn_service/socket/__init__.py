"""The WebSocket ``/v1/drive``, from the bytes of a connection to the calls that they hold."""
