"""``python -m gapsweep``: the command line."""

from gapsweep.cli import main

main()
