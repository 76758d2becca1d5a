"""A run as one sees it who sits at a terminal: never mute, and clean where it ends."""

import os
import re
import select
import signal
import sys
import time
from itertools import pairwise

import pytest

pytestmark = pytest.mark.extended

pty = pytest.importorskip("pty")

STUDY = """
oscillator = { mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }
[study]
name = "tiny"
[[sweep]]
representation = "piecewise"
K_c = 1.4e4
gap = [0.4e-3, 0.4e-3]
omega = { start = 6.0, stop = 30.0, num = 200 }
[solver]
engine = "scipy"
rtol = 1e-8
"""
# Promised are 2 s; processes of other tests may hold this one up.
MUTE_SECONDS = 4.0
COMMAND = [sys.executable, "-c", "from gapsweep.cli import main; main()", "run", "tiny.toml"]


def watched(folder, until):
    """Exit code, all that was written and when; Ctrl-C is typed once words are read."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        os.environ |= {"COLUMNS": "80", "LINES": "24", "TERM": "xterm"}
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # ignored if a script started pytest with &
        os.execv(COMMAND[0], COMMAND)
    written, begun, is_typed = [(0.0, "")], time.monotonic(), False
    while written[-1][0] < 120.0:
        if select.select([terminal], [], [], 0.05)[0]:
            try:
                text = os.read(terminal, 65536).decode(errors="replace")
            except OSError:  # the other side has closed
                break
            written.append((time.monotonic() - begun, text))
        if not is_typed and until in written[-1][1]:
            os.write(terminal, b"\x03")
            is_typed = True
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), written


@pytest.mark.parametrize("until", ["starting the workers", "points,"])
def test_ctrl_c_leaves_one_clean_line(until, tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY)
    code, written = watched(tmp_path, until)
    text = "".join(text for _, text in written)
    assert code == 130
    # Every line before was drawn over; none was so long that ^C broke it.
    _, _, last = text.rpartition("\x1b[2K")
    left = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", last)
    assert left.split("\r\n")[-2:] == ["interrupted; run again to resume", ""]
    assert left.strip() == "interrupted; run again to resume"
    drawn = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text)
    assert max(map(len, re.split(r"[\r\n]+", drawn))) < 80
    gaps = [b - a for (a, _), (b, _) in pairwise(written)]
    assert max(gaps) < MUTE_SECONDS
