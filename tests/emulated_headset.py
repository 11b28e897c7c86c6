"""A headset that is not there: Meta's Immersive Web Emulation Runtime in a headless browser."""

import shutil
import subprocess
import tarfile
from pathlib import Path
from typing import Any

PACKAGE = "iwer@2.5.0"
_INSIDE = "package/build/iwer.min.js"

# The emulated hands move about and pinch and open, twice a second.
MOVE = """
window.headset = new IWER.XRDevice(IWER.metaQuest3, {stereoEnabled: true});
headset.installRuntime({forceInstall: true});
headset.primaryInputMode = 'hand';
window.moving = true;
setInterval(() => {
  if (!window.moving) return;
  const t = performance.now() / 1000;
  for (const [side, sign] of [['left', -1], ['right', 1]]) {
    const hand = headset.hands[side];
    hand.position.set(sign * (0.16 + 0.02 * Math.sin(3 * t)), 1.5 + 0.03 * Math.cos(2 * t), -0.35);
    hand.updatePinchValue(0.5 - 0.5 * Math.cos(4 * Math.PI * t));
  }
}, 10);
"""


class NoEmulator(Exception):
    """The emulator can't be had here."""


def fetch_emulator(folder: Path) -> str:
    """The script of the emulator, from the npm registry or from an earlier time.

    Args:
        folder: where it is kept.

    Raises:
        NoEmulator: with the reason.
    """
    archive = folder / f"{PACKAGE.replace('@', '-')}.tgz"
    if not archive.exists():
        npm = shutil.which("npm")
        if npm is None:
            raise NoEmulator(f"npm is not installed, so {PACKAGE} can't be had")
        command = [npm, "pack", PACKAGE, "--silent", "--pack-destination", str(folder)]
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        except subprocess.TimeoutExpired:
            raise NoEmulator(f"npm did not bring {PACKAGE} within a minute") from None
        if run.returncode or not archive.exists():
            last = (run.stderr.strip() or "no reason given").splitlines()[-1]
            raise NoEmulator(f"npm can't bring {PACKAGE}: {last}")
    with tarfile.open(archive) as inside:
        script = inside.extractfile(_INSIDE)
        return script.read().decode()


def new_headset(browser: Any, emulator: str, width: int = 480, height: int = 640) -> Any:
    """A page in a browser that has a headset with two moving hands, and accepts any certificate."""
    context = browser.new_context(
        ignore_https_errors=True, viewport={"width": width, "height": height}
    )
    page = context.new_page()
    page.set_default_timeout(120_000)  # software rendering on a busy machine
    page.add_init_script(f"{emulator}\n;{MOVE}")
    return page


def pair(page: Any, address: str, code: str, mode: str | None = None) -> None:
    """Opens the page of a source, which pairs by the code in the address, and chooses a mode."""
    page.goto(f"{address}/#{code}")
    page.locator("#state", has_text="linked").wait_for()
    if mode is not None:
        page.select_option("#mode", mode)
