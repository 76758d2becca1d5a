"""Build hook: a wheel that carries machine code is one for this Python and operating system."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Hook(BuildHookInterface):  # type: ignore[type-arg]  # of no configuration of its own
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if Path(self.root, "pipeline", "gapsweep", "machine_code").is_dir():
            build_data["pure_python"] = False
            build_data["infer_tag"] = True
