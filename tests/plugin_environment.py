"""A Python environment of its own with distributions of this repository installed."""

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path


def environment_with(folder: Path, *sources: Path) -> Path:
    """Python of a new environment that has distributions, and all that this one has.

    Args:
        folder: where the environment is made.
        sources: folders with a ``pyproject.toml``; they are copied first.
    """
    home, copies = folder / "venv", [folder / source.name for source in sources]
    for source, copy in zip(sources, copies, strict=True):
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    paths = sysconfig.get_paths(vars={"base": str(home), "platbase": str(home)})
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home), "platbase": str(home)}))
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    install += ["--no-build-isolation", "--target", str(site), *map(str, copies)]
    subprocess.run(install, check=True)
    own = [path for path in map(Path, sys.path) if path.name == "site-packages"]
    lines = [f"import site; site.addsitedir({str(path)!r})" for path in own]
    (site / "parent.pth").write_text("\n".join(lines) + "\n")
    return Path(paths["scripts"]) / Path(sys.executable).name
