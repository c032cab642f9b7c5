"""Takes everything from this process that a model's run does not need. There is no way back.

A guest calls :func:`confine` once its libraries are loaded, and before it reads the model. Bubblewrap or a container
hide the machine's files, processes and network beforehand. What follows here holds without them too.
"""

import ctypes
import ctypes.util
import errno
import gc
import mmap
import os
import resource
import signal
import time
from typing import Any, Final

_PR_SET_PDEATHSIG: Final = 1
_PR_SET_DUMPABLE: Final = 4
_PR_SET_NO_NEW_PRIVS: Final = 38
SECCOMP_LIBRARY: Final = "libseccomp.so.2"
"""Name of the library that pyseccomp needs."""
_ALLOWED: Final = """
read readv write writev recvfrom sendto poll ppoll close exit exit_group
brk munmap mremap madvise
futex futex_time64 futex_waitv set_robust_list rseq membarrier sched_yield
rt_sigaction rt_sigprocmask rt_sigreturn sigaltstack restart_syscall
clock_gettime clock_getres clock_nanosleep nanosleep gettimeofday time getrandom
getpid gettid getrusage times getcpu sched_getaffinity sysinfo uname
"""
"""System calls that computing needs. None of them opens, connects, starts or finds anything."""
_DRIVER: Final = "ioctl openat fstat newfstatat statx lseek fcntl eventfd2"
"""What CUDA's library needs as well. Of files, the sandbox has libraries and the GPU's devices."""


def confine(*, gpu: bool = False, life_s: float = 120.0) -> None:
    """Forbid all system calls but those of computing, new privileges, core dumps and other processes' looks.

    With ``gpu`` the driver's are allowed too. After ``life_s`` more of processor time the kernel ends it. Raises
    OSError if the kernel refuses, or libseccomp is missing.
    """
    filter_ = _filter(_ALLOWED + _DRIVER if gpu else _ALLOWED)
    _prctl(_PR_SET_DUMPABLE, 0)
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    for limit, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NPROC, 0),
        (resource.RLIMIT_MEMLOCK, 0),
        (resource.RLIMIT_MSGQUEUE, 0),
        (resource.RLIMIT_CPU, int(time.process_time() + life_s) + 2),
        (resource.RLIMIT_NOFILE, 256 if gpu else 16),
    ):
        resource.setrlimit(limit, (most, most))
    filter_.load()


def limit_memory(most: int) -> None:
    """Let this process take at most so many more bytes of address space. It cannot be undone."""
    gc.collect()
    limit = _mapped() + most
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def limit_processor_time(seconds: float) -> None:
    """End this process by SIGXCPU once it has used so many more seconds of processor time."""
    soft, (_, hard) = int(time.process_time() + seconds) + 2, resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))


def end_with_parent() -> None:
    """Let the kernel end this process when its parent ends."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def load_seccomp() -> Any:
    """Return the module pyseccomp. Raises OSError if libseccomp is missing."""
    find = ctypes.util.find_library
    ctypes.util.find_library = _find_seccomp  # the real one starts programs to search
    try:
        import pyseccomp  # noqa: PLC0415 - searches its library when it is imported
    except (OSError, RuntimeError) as error:
        raise OSError(
            errno.ENOENT, f"{SECCOMP_LIBRARY} is missing ({error}); install it, on Debian: apt-get install libseccomp2"
        ) from None
    finally:
        ctypes.util.find_library = find
    return pyseccomp


def _find_seccomp(name: str) -> str | None:  # noqa: ARG001 - takes the place of ctypes' own
    return SECCOMP_LIBRARY


def _filter(allowed: str) -> Any:
    seccomp = load_seccomp()
    filter_ = seccomp.SyscallFilter(seccomp.ERRNO(errno.EPERM))
    filter_.set_attr(seccomp.Attr.CTL_TSYNC, 1)  # for all threads, should a library have started one
    for name in allowed.split():
        try:
            number = seccomp.resolve_syscall(seccomp.Arch.NATIVE, name)
        except (OSError, ValueError):
            continue  # a newer or older kernel's
        if number >= 0:
            filter_.add_rule(seccomp.ALLOW, name)
    for name in ("mmap", "mprotect"):  # memory to run code from is not needed any more
        filter_.add_rule(seccomp.ALLOW, name, seccomp.Arg(2, seccomp.MASKED_EQ, mmap.PROT_EXEC, 0))
    filter_.add_rule(seccomp.ALLOW, "prlimit64", seccomp.Arg(0, seccomp.EQ, 0))  # its own limits alone
    filter_.add_rule(seccomp.ALLOW, "tgkill", seccomp.Arg(0, seccomp.EQ, os.getpid()))  # abort()
    return filter_


def _mapped() -> int:
    """Return this process's address space in bytes: the least limit under which one more page can be had.

    The sandbox has no ``/proc`` to read it from.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    low, high = 0, 1 << 47
    try:
        while high - low > mmap.PAGESIZE:
            middle = (low + high) // 2
            resource.setrlimit(resource.RLIMIT_AS, (middle, hard))
            try:
                mmap.mmap(-1, mmap.PAGESIZE).close()
            except (OSError, MemoryError):
                low = middle
            else:
                high = middle
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    return high


def _prctl(option: int, value: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl {option}: {os.strerror(number)}")
