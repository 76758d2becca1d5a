"""Locks on files, where the operating system has them."""

try:
    import fcntl as fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]  # who locks tests for a module that is not there
