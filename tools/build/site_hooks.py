"""Hooks of mkdocs: the version at the foot of each page, and nothing that is loaded from elsewhere."""

import tomllib
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
# mkdocs-material's plugin `offline` loads this from a server; a copy is among the documents.
ELSEWHERE, SHIM = "https://unpkg.com/iframe-worker/shim", "iframe_worker.js"


def on_config(config: Any) -> Any:
    """mkdocs calls it with its configuration, and takes what comes back. Raises OSError."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    config["copyright"] = f"Headland {project['version']}, licence {project['license']}"
    return config


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """The page of errors, the only template of HTML that is no page."""
    return output.replace(ELSEWHERE, SHIM)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """The HTML of a page, with the script for a search from a disk out of our own folder."""
    own = "../" * page.url.count("/") + SHIM
    return output.replace(ELSEWHERE, own)
