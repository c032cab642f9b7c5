"""The one place that imports onnxruntime, without its telemetry.

From 1.29 on, onnxruntime starts a thread that keeps a database in the home folder and looks for its maker's servers.
"""

import os
from types import ModuleType


def load_onnxruntime() -> ModuleType:
    """Import onnxruntime with its telemetry off, unless ``ORT_DISABLE_TELEMETRY`` says otherwise.

    Raises:
        ImportError: onnxruntime is not installed.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when it is imported
    import onnxruntime  # noqa: PLC0415 - comes with an extra, and is slow to import

    module: ModuleType = onnxruntime
    return module
