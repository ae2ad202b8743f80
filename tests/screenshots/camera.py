"""Photographs of the page in Chromium, equal to the pixel from run to run, as small PNG files."""

from __future__ import annotations

import base64
import io
from pathlib import Path

from PIL import Image

from tests.screenshots.frozen_cell import NOW_S
from tests.system.browser import Page

SIZES = {"light": (1440, 900, "light"), "dark": (1440, 900, "dark"), "phone": (390, 844, "light")}
"""Width and height in CSS pixels, and colors."""
COLORS = 64
"""Number of colors of a picture: text stays sharp, and a picture has some 40 kB."""
FREEZE = """
{
  const now = NOW, Real = Date;
  globalThis.Date = class extends Real {
    constructor(...given) { super(...(given.length ? given : [now])); }
    static now() { return now; }
  };
  addEventListener("DOMContentLoaded", () => {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync("*, *::before, *::after { animation: none !important; transition: none !important;"
      + " caret-color: transparent !important } ::-webkit-scrollbar { display: none }");
    document.adoptedStyleSheets = [sheet];
  });
}
""".replace("NOW", str(round(1000 * NOW_S)))
SETTLED = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 150))))"
OPTIONS = (
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--force-color-profile=srgb", "--lang=en-US",
    "--font-render-hinting=none", "--disable-lcd-text",
)  # fmt: skip
"""WebGL without a graphics card, and text that does not depend on the screen."""


class Camera:
    """A page whose time stands still."""

    def __init__(self, page: Page) -> None:
        self.page = page
        page.call("Page.addScriptToEvaluateOnNewDocument", source=FREEZE)
        page.call("Emulation.setTimezoneOverride", timezoneId="UTC")

    def aim(self, size: str) -> None:
        """Set one of ``SIZES``."""
        width, height, scheme = SIZES[size]
        self.page.aim(width, height, scheme)

    def look(self) -> bytes:
        """Return what is shown, as PNG, once two looks are the same."""
        last = b""
        for _ in range(40):
            self.page.run(SETTLED)
            now = base64.b64decode(self.page.call("Page.captureScreenshot", format="png")["data"])
            if now == last:
                break
            last = now
        return now

    def shoot(self, path: Path) -> int:
        """Write a picture; its bytes. A picture that is the same is not written again."""
        image = Image.open(io.BytesIO(self.look())).convert("RGB")
        small = image.quantize(COLORS, method=Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
        buffer = io.BytesIO()
        small.save(buffer, "PNG", optimize=True)
        if not path.exists() or path.read_bytes() != buffer.getvalue():
            path.write_bytes(buffer.getvalue())
        return len(buffer.getvalue())
