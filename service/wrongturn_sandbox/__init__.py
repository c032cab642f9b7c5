"""Runs models of strangers where they can do no harm: the guest inside, the host outside. It knows no other part.

::

    with open_sandbox(None, Limits(memory=1 << 30)) as sandbox:
        description = sandbox.load(Path("agent.onnx").read_bytes())
        outputs = sandbox.run({"speed": np.zeros((1, 1), np.float32)})
"""

from wrongturn_sandbox.errors import ModelRefusedError, SandboxBusyError, SandboxLostError, SandboxUnavailableError
from wrongturn_sandbox.host import Sandbox, open_sandbox, probe
from wrongturn_sandbox.messages import Description, Limits, TensorInfo

__all__ = [
    "Description",
    "Limits",
    "ModelRefusedError",
    "Sandbox",
    "SandboxBusyError",
    "SandboxLostError",
    "SandboxUnavailableError",
    "TensorInfo",
    "open_sandbox",
    "probe",
]
