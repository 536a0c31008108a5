"""Hook of mkdocs: pages made from the docstrings, one for each room, and the pages that lie outside docs/.

A page of a room lists the public functions and classes of all its modules, so that no list of modules is kept by hand.
"""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
LIBRARY = ROOT / "quasi"
OUTSIDE = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}


def modules_of(folder: Path) -> list[str]:
    """Dotted names of the modules in a folder of the library and below it, packages before their modules."""
    paths = [p for p in sorted(folder.rglob("*.py")) if p.read_text(encoding="utf-8").strip()]
    names = [".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for p in paths]
    return sorted(names)


def pages() -> dict[str, str]:
    """{path in the site: Markdown} of the reference."""
    rooms = [folder for folder in sorted(LIBRARY.iterdir()) if (folder / "__init__.py").is_file()]
    titles = {f"quasi.{room.name}": room for room in rooms} | {"quasi_synthesis": ROOT / "quasi_synthesis"}
    made = {f"reference/{room.name}.md": _page(title, modules_of(room)) for title, room in titles.items()}
    loose = [f"quasi.{p.stem}" for p in sorted(LIBRARY.glob("*.py")) if p.stem != "__init__"]
    made["reference/top-level.md"] = _page("quasi: top level", loose)
    rows = [f"| [{path.split('/')[1][:-3]}]({path.split('/')[1]}) |" for path in made]
    start = (
        "# Overview\n\nPublic functions and classes by room, from their docstrings. "
        "The rooms: [architecture](../architecture.md).\n\n"
    )
    return {"reference/index.md": start + "| room |\n| --- |\n" + "\n".join(rows) + "\n", **made}


def _page(title: str, modules: list[str]) -> str:
    return f"# {title}\n\n" + "\n\n".join(f"::: {name}" for name in modules) + "\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the section Reference to the navigation."""
    config.nav.append({"Reference": list(pages())})
    return config


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Mark the paragraphs of docstrings that stand in columns, so that their lines and spaces are kept."""
    if not page.url.startswith("reference/"):
        return html
    return re.sub(r"<p>(?=(?:(?!</p>).)*?\S {2,}\S)", '<p class="rows">', html, flags=re.S)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    for name, path in OUTSIDE.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, path, content=re.sub(r"\]\(docs/", "](", text)))
    return files
