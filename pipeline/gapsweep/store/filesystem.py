"""What the file system below a path is, and locks on files: not all can be shared alike."""

from pathlib import Path

import psutil

try:
    import fcntl as fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]  # who locks tests for a module that is not there

# Types of file systems that several machines may share, as the operating systems name them.
_NETWORK = {
    *("9p", "afs", "afpfs", "beegfs", "ceph", "cifs", "fuse.ceph", "fuse.glusterfs", "fuse.sshfs"),
    *("glusterfs", "gpfs", "lustre", "ncpfs", "nfs", "nfs4", "orangefs", "panfs", "pvfs2"),
    *("smb2", "smb3", "smbfs", "webdav"),
}


def is_on_network(path: Path) -> bool:
    """Whether a path lies on a network file system; False where that cannot be told."""
    return _type(path.resolve()) in _NETWORK


def _type(path: Path) -> str:
    """File system of the innermost mount point that holds the path."""
    try:
        mounts = psutil.disk_partitions(all=True)
    except (OSError, NotImplementedError):
        return ""
    holding = [m for m in mounts if path.is_relative_to(m.mountpoint)]
    # Of two mounted in one place, the later one is seen.
    return max(reversed(holding), key=lambda m: len(m.mountpoint)).fstype if holding else ""
