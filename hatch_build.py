"""Builds the live web page for the wheel, where Node.js is at hand."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

COMMANDS = (["npm", "ci", "--omit=dev", "--ignore-scripts"], ["npm", "run", "build"])


class PageBuildHook(BuildHookInterface):
    """Runs npm in web/. Without npm, the wheel has no page, and `geort-drake live` says how to get it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        web = Path(self.root) / "web"
        if version == "editable" or not web.is_dir():
            return
        try:
            for command in COMMANDS:
                subprocess.run([shutil.which(command[0]) or command[0], *command[1:]], cwd=web, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            self.app.display_warning(f"The wheel has no live web page, which needs Node.js and npm: {error}")
