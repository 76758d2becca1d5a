"""A headless Chromium for the tests of this folder."""

import re
import shutil
import subprocess

import pytest

OPTIONS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --remote-debugging-port=0"
)


@pytest.fixture(scope="session")
def debugger(tmp_path_factory):
    """Address of a running Chromium, for its debugging protocol."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    assert program, "no Chromium found; Debian: apt install chromium"
    profile = tmp_path_factory.mktemp("profile")
    command = [program, *OPTIONS.split(), f"--user-data-dir={profile}", "about:blank"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if found := re.search(r"ws://(\S+?)/devtools/browser", line):
                break
        yield found[1]
        process.kill()
