"""Take away from Python what Windows and macOS lack, before anything of stillcal is imported.

A folder with this file on PYTHONPATH does it for a process and its children. What the standard library and
numpy need on the host that runs the tests is left (os.fork, os.getuid, os.sysconf). Packages that are
built for the host, such as Dask's, are named in BUILT_FOR_HOST and imported first.
"""

import importlib
import importlib.abc
import os
import signal
import socket
import subprocess
import sys
import time

for package in os.environ.get("BUILT_FOR_HOST", "").split():
    importlib.import_module(package)

MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}

POSIX = """
    O_CLOEXEC O_DIRECTORY O_NOCTTY O_NOFOLLOW O_NONBLOCK O_SYNC chown fchmod fchown forkpty getegid geteuid
    getgid getloadavg killpg lchown mkfifo mknod nice openpty posix_fadvise pread preadv pwrite
    pwritev sched_getaffinity sched_setaffinity setsid statvfs sync ttyname
"""
SIGNALS = "SIGALRM SIGHUP SIGKILL SIGPIPE SIGQUIT SIGUSR1 SIGUSR2 alarm pause setitimer"
SOCKETS = "AF_UNIX SOCK_CLOEXEC SOCK_NONBLOCK SO_PEERCRED socketpair"
CLOCKS = "CLOCK_BOOTTIME CLOCK_MONOTONIC CLOCK_MONOTONIC_RAW CLOCK_REALTIME clock_gettime clock_settime"


class _Absent(importlib.abc.MetaPathFinder):
    """Finds none of MODULES."""

    def find_spec(self, name, path=None, target=None):
        if name in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


class _Locking:
    """msvcrt, as far as the store uses it: a byte of a file is locked, as Windows does it."""

    LK_NBLCK = 2

    def __init__(self, fcntl):
        self._lockf, self._how = fcntl.lockf, fcntl.LOCK_EX | fcntl.LOCK_NB

    def locking(self, fd, mode, nbytes):
        assert mode == self.LK_NBLCK
        try:
            self._lockf(fd, self._how, nbytes, 0, 1)
        except BlockingIOError as error:
            raise PermissionError(*error.args) from None


def _take(names, *modules):
    for name in names.split():
        for module in modules:
            if hasattr(module, name):
                delattr(module, name)


assert not subprocess._mswindows  # it looks for msvcrt when it is imported
msvcrt = _Locking(importlib.import_module("fcntl"))
_take(POSIX, os, sys.modules["posix"])
_take(SIGNALS, signal, sys.modules["_signal"])
_take(SOCKETS, socket, sys.modules["_socket"])
_take(CLOCKS, time)
importlib.reload(socket)  # which now makes socket pairs of TCP, as on Windows
for name in MODULES:
    sys.modules.pop(name, None)
sys.modules["msvcrt"] = msvcrt
sys.meta_path.insert(0, _Absent())
