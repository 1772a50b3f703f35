"""Chromium without a window: what a page looks like once its scripts have run, and its printed form.

Chromium comes with the system's packages (`apt-get install chromium`; `make install-test` does it where it may).
Without it these tests fail and say so: they are not skipped.
"""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

MISSING = "chromium is not installed: run `make install-test` as root, or `apt-get install chromium` (CONTRIBUTING.md)"

FIRST = """<script>
window.wrong = [];
addEventListener("error", (e) => wrong.push(String(e.message || e.target.src)), true);
addEventListener("unhandledrejection", (e) => wrong.push(String(e.reason)));
for (const name of ["error", "warn"]) console[name] = (...said) => wrong.push(said.join(" "));
</script>"""
LAST = """<script>
addEventListener("load", () => setTimeout(() => {
  const inked = (canvas) => {
    const { width, height } = canvas, px = canvas.getContext("2d").getImageData(0, 0, width, height).data;
    const columns = new Set(), colours = new Set();
    for (let k = 0; k < px.length; k += 4)
      if (px[k + 3] > 200) { columns.add((k / 4) % width); colours.add(px[k] + "," + px[k + 1] + "," + px[k + 2]); }
    return { columns: columns.size / width, colours: [...colours].length };
  };
  const found = {
    wrong, title: document.title, width: document.documentElement.scrollWidth,
    paper: getComputedStyle(document.body).backgroundColor,
    panels: [...document.querySelectorAll(".panel")].map((p) =>
      ({ title: p.querySelector("h3").textContent, ...inked(p.querySelector("canvas")) })),
    bars: [...document.querySelectorAll("#band rect:not(.slot):not(.hit)")].length,
    words: [...document.querySelectorAll("#band text")].map((t) => t.textContent),
    cut: [...document.querySelectorAll("table")].filter((t) => t.scrollWidth > t.parentElement.clientWidth + 1).length,
  };
  const e = document.createElement("script"); e.id = "probe"; e.type = "application/json";
  e.textContent = JSON.stringify(found); document.body.append(e);
}, 300));
</script>"""


def look(page: str, *, dark: bool = False, width: int = 1200) -> dict[str, Any]:
    """What a page shows: errors of its scripts, panels with the share of columns that have ink, bars and their words.

    Parameters
    ----------
    page : str
        HTML.
    dark : bool
        Whether the user prefers dark colours.
    width : int
        Of the window.
    """
    probed = page.replace("<head>", "<head>" + FIRST, 1).replace("</body>", LAST + "</body>", 1)
    words = [f"--blink-settings=preferredColorScheme={0 if dark else 1}", f"--window-size={width},1400", "--dump-dom"]
    text = _run(probed, words)
    found = re.search(r'<script id="probe"[^>]*>(.*?)</script>', text, re.DOTALL)
    assert found is not None, "the page's scripts did not come to their end"
    return json.loads(html.unescape(found[1]))


def printed(page: str) -> bytes:
    """The page as PDF."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.pdf"
        _run(page, ["--no-pdf-header-footer", f"--print-to-pdf={path}"])
        return path.read_bytes()


def _run(page: str, words: list[str]) -> str:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        raise RuntimeError(MISSING)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.html"
        path.write_text(page, encoding="utf-8")
        command = [program, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        command += [f"--user-data-dir={folder}/user", "--virtual-time-budget=5000", *words, path.as_uri()]
        done = subprocess.run(command, timeout=120, check=False, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"chromium: {done.stderr[-2000:]}")
    return done.stdout
