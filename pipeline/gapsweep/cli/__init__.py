"""The command line: from arguments to an exit code.

Exit codes: 0 finished; 1 a study, file or cluster error; 2 a wrong command line; 3
finished, but some points failed; 130 interrupted, resumable.
"""

from gapsweep.cli.main import main

__all__ = ["main"]
