"""Textures of things with something on them: posters, screens, books, drawers, cartons, windows."""

import cv2
import numpy as np

from stillroom.geometry.arrays import U8
from stillroom_scenes.scene import surfaces
from stillroom_scenes.scene.surfaces import Rgb

WORDS = ("map", "loop", "frame", "still", "room", "depth", "point", "track", "pose", "scale", "light", "chair", "wall")
FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_COMPLEX)


def any_colour(rng: np.random.Generator, low: int = 20, high: int = 235) -> Rgb:
    """Return some colour."""
    red, green, blue = (int(value) for value in rng.integers(low, high, 3))
    return red, green, blue


def write_lines(rng: np.random.Generator, picture: U8, scale: float, colour: Rgb, top: int, bottom: int) -> None:
    """Fill rows of the picture with words."""
    font = int(rng.choice(FONTS))
    step = max(6, int(26 * scale))
    for y in range(top + step, bottom, step):
        words = " ".join(rng.choice(WORDS) for _ in range(int(rng.integers(2, 9))))
        indent = int(rng.integers(6, 6 + picture.shape[1] // 6))
        cv2.putText(picture, words, (indent, y), font, scale, colour, 1, cv2.LINE_AA)


def poster(rng: np.random.Generator, width: int = 256, height: int = 320) -> U8:
    """Draw one of several kinds of poster."""
    kind = (_page, _chart, _landscape, _shapes)[int(rng.integers(4))]
    picture = kind(rng, width, height)
    noise = surfaces.speckle(rng, height, width, 1, 4)[..., None]
    picture = np.clip(picture + 5.0 * noise, 0, 255).astype(np.uint8)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), any_colour(rng, 10, 90), 3)
    return picture


def _page(rng: np.random.Generator, width: int, height: int) -> U8:
    picture = np.full((height, width, 3), 242, dtype=np.uint8)
    picture[: height // 8] = any_colour(rng, 20, 160)
    write_lines(rng, picture, 0.8, (245, 245, 245), -4, height // 8)
    write_lines(rng, picture, 0.38, (30, 30, 40), height // 7, height - 6)
    x, y = int(rng.integers(10, width // 2)), int(rng.integers(height // 4, height // 2))
    corner = x + width // 2 - 12, y + height // 4
    cv2.rectangle(picture, (x, y), corner, any_colour(rng, 60, 220), -1)
    for _ in range(9):
        spot = int(rng.integers(x, corner[0])), int(rng.integers(y, corner[1]))
        cv2.circle(picture, spot, int(rng.integers(2, 12)), any_colour(rng), -1, cv2.LINE_AA)
    return picture


def _chart(rng: np.random.Generator, width: int, height: int) -> U8:
    picture = np.full((height, width, 3), any_colour(rng, 200, 250), dtype=np.uint8)
    write_lines(rng, picture, 0.6, (20, 20, 20), 0, height // 9)
    for x in range(16, width - 20, 20):
        top = int(rng.integers(height // 6, height // 2))
        cv2.rectangle(picture, (x, top), (x + 13, height // 2), any_colour(rng, 20, 200), -1)
    for _ in range(3):
        y = np.cumsum(rng.normal(0, 7, 18)) + 0.72 * height
        line = np.stack((np.linspace(12, width - 12, 18), y), axis=1).astype(np.int32)
        cv2.polylines(picture, [line], False, any_colour(rng, 10, 170), 2, cv2.LINE_AA)
    write_lines(rng, picture, 0.35, (60, 60, 60), int(0.85 * height), height - 4)
    return picture


def _landscape(rng: np.random.Generator, width: int, height: int) -> U8:
    rows = np.linspace(0, 1, height)[:, None, None]
    sky, ground = np.array(any_colour(rng, 120, 245)), np.array(any_colour(rng, 40, 160))
    shades = np.broadcast_to(sky * (1 - rows) + ground * rows, (height, width, 3))
    picture: U8 = np.ascontiguousarray(shades, dtype=np.uint8)
    for layer in range(4):
        ridge = np.cumsum(rng.normal(0, 5, width // 8 + 2)) + height * (0.35 + 0.15 * layer)
        outline = np.stack((8.0 * np.arange(len(ridge)), np.asarray(ridge, dtype=np.float64)), axis=1)
        corners = np.array([[width, height], [0, height]], dtype=np.float64)
        outline = np.concatenate((outline, corners))
        cv2.fillPoly(picture, [outline.astype(np.int32)], any_colour(rng, 20, 200), cv2.LINE_AA)
    for _ in range(40):
        x, y = int(rng.integers(width)), int(rng.integers(height // 2, height))
        size = int(rng.integers(3, 12))
        cv2.rectangle(picture, (x, y), (x + size, y + size), any_colour(rng), -1)
    return picture


def _shapes(rng: np.random.Generator, width: int, height: int) -> U8:
    picture = np.full((height, width, 3), any_colour(rng, 180, 250), dtype=np.uint8)
    for _ in range(28):
        corners = rng.integers(0, (width, height), (int(rng.integers(3, 6)), 2)).astype(np.float64)
        corners = corners.mean(axis=0) + 0.35 * (corners - corners.mean(axis=0))
        cv2.fillPoly(picture, [corners.astype(np.int32)], any_colour(rng), cv2.LINE_AA)
    write_lines(rng, picture, 0.9, (15, 15, 15), int(0.8 * height), height)
    return picture


def screen(rng: np.random.Generator, width: int = 256, height: int = 160) -> U8:
    """Draw a monitor that shows windows with text."""
    picture = np.full((height, width, 3), any_colour(rng, 20, 90), dtype=np.uint8)
    for _ in range(3):
        x, y = int(rng.integers(0, width // 2)), int(rng.integers(0, height // 2))
        inner = picture[y : y + int(0.55 * height), x : x + int(0.6 * width)]
        dark = bool(rng.integers(2))
        inner[:] = (30, 32, 40) if dark else (240, 240, 240)
        inner[:8] = any_colour(rng, 60, 180)
        page = np.ascontiguousarray(inner)
        write_lines(rng, page, 0.32, any_colour(rng, 150, 250) if dark else any_colour(rng, 0, 90), 8, len(page))
        inner[:] = page
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (18, 18, 18), 7)
    return picture


def _muted(colour: Rgb) -> Rgb:
    """Return a colour halfway to its grey."""
    grey = sum(colour) // 3
    red, green, blue = ((value + grey) // 2 for value in colour)
    return red, green, blue


def books(rng: np.random.Generator, width: int = 384, height: int = 96) -> U8:
    """Draw a row of book spines on a shelf."""
    picture = np.full((height, width, 3), 35, dtype=np.uint8)
    x = 3
    while x < width - 10:
        thick, top = int(rng.integers(9, 26)), int(rng.integers(4, height // 3))
        colour = _muted(any_colour(rng, 30, 200))
        spine = picture[top:, x : x + thick - 1]
        spine[:] = colour
        spine[:, :2] = (spine[:, :2] * 0.7).astype(np.uint8)
        ink = (215, 208, 190) if sum(colour) < 330 else (40, 34, 40)
        for band in rng.integers(4, max(5, spine.shape[0] - 8), 3):
            spine[band : band + int(rng.integers(1, 7)), 2:-2] = ink
        for _ in range(5):
            row = int(rng.integers(2, max(3, spine.shape[0] - 4)))
            spine[row : row + 2, int(rng.integers(2, 5)) : -3] = _muted(any_colour(rng))
        x += thick + int(rng.choice([0, 0, 0, 0, 6]))
    picture[-4:] = 60
    gain = np.linspace(0.6, 1.0, height)[:, None, None]  # the board above takes the light
    return (picture * gain).astype(np.uint8)


def drawers(rng: np.random.Generator, width: int, height: int, colour: Rgb, columns: int, rows: int) -> U8:
    """Draw a cabinet front with drawers, handles and labels."""
    picture = surfaces.metal(rng, width, height, colour)
    dark = tuple(int(c * 0.45) for c in colour)
    for row in range(rows):
        for column in range(columns):
            x, y = column * width // columns, row * height // rows
            right, low = (column + 1) * width // columns, (row + 1) * height // rows
            picture[y:low, x:right] = np.clip(picture[y:low, x:right] * rng.normal(1, 0.05), 0, 255)
            cv2.rectangle(picture, (x + 1, y + 1), (right - 2, low - 2), dark, 2)
            middle = (x + right) // 2, y + max(6, (low - y) // 3)
            cv2.rectangle(picture, (middle[0] - 14, middle[1]), (middle[0] + 14, middle[1] + 4), (205, 205, 200), -1)
            label = x + int(rng.integers(6, 16)), y + int(rng.integers(5, 10))
            cv2.rectangle(picture, label, (label[0] + 26, label[1] + 12), any_colour(rng, 190, 255), -1)
            cv2.putText(picture, str(rng.choice(WORDS))[:4], (label[0] + 2, label[1] + 9), 0, 0.3, (20, 20, 20), 1)
    return surfaces.darken_borders(picture, 12, 0.25)


def carton(rng: np.random.Generator, size_px: int = 192) -> U8:
    """Draw the side of a cardboard box with tape, prints and a label."""
    picture = surfaces.wood(rng, size_px, size_px, (186, 148, 104), 2)
    cv2.rectangle(picture, (0, size_px // 2 - 9), (size_px, size_px // 2 + 9), (206, 186, 150), -1)
    for _ in range(3):
        x, y = (int(v) for v in rng.integers(8, int(0.6 * size_px), 2))
        wide, tall = int(rng.integers(35, 75)), int(rng.integers(22, 50))
        label = np.full((tall, wide, 3), any_colour(rng, 200, 255), dtype=np.uint8)
        write_lines(rng, label, 0.32, (20, 20, 20), 0, tall)
        cv2.rectangle(label, (wide - 16, 3), (wide - 4, 15), any_colour(rng, 0, 120), -1)
        picture[y : y + tall, x : x + wide] = label[: size_px - y, : size_px - x]
    cv2.putText(picture, str(rng.choice(WORDS)).upper(), (12, size_px - 16), 1, 2.2, (70, 40, 25), 3, cv2.LINE_AA)
    return surfaces.darken_borders(picture, 8, 0.3)


def window(rng: np.random.Generator, size_px: int = 256) -> U8:
    """Draw a window with a frame and houses behind it."""
    picture = _landscape(rng, size_px, size_px)
    for _ in range(7):
        x, top = int(rng.integers(size_px)), int(rng.integers(size_px // 3, int(0.8 * size_px)))
        wide = int(rng.integers(25, 60))
        cv2.rectangle(picture, (x, top), (x + wide, size_px), any_colour(rng, 90, 210), -1)
        for row in range(top + 6, size_px - 6, 14):
            for column in range(x + 5, x + wide - 6, 11):
                cv2.rectangle(picture, (column, row), (column + 5, row + 8), (60, 70, 90), -1)
    for line in (0, size_px // 2 - 5, size_px - 10):
        picture[:, line : line + 10] = 232
        picture[line : line + 10] = 232
    return picture


def scribbles(rng: np.random.Generator, width: int = 384, height: int = 256) -> U8:
    """Draw a whiteboard after a long meeting."""
    picture = surfaces.tinted(1.0 + 0.012 * surfaces.speckle(rng, height, width, 1, 5), (238, 240, 240))
    inks: tuple[Rgb, ...] = ((30, 40, 140), (150, 30, 30), (20, 110, 50), (30, 30, 30))
    for k in range(16):
        ink = inks[int(rng.integers(4))]
        x, y = int(rng.integers(12, width - 110)), int(rng.integers(24, height - 30))
        if k % 3 == 0:
            cv2.rectangle(picture, (x, y - 18), (x + int(rng.integers(40, 95)), y + 10), ink, 2, cv2.LINE_AA)
        if k % 3 == 1:
            cv2.arrowedLine(picture, (x, y), (x + int(rng.integers(30, 90)), y + int(rng.integers(-30, 30))), ink, 2)
        scale = float(rng.uniform(0.45, 0.8))
        cv2.putText(picture, str(rng.choice(WORDS)), (x + 6, y), 16, scale, ink, 1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (150, 152, 155), 6)
    return picture


def notes(rng: np.random.Generator, width: int = 320, height: int = 224) -> U8:
    """Draw a cork board with paper notes."""
    picture = surfaces.tinted(1.0 + 0.14 * surfaces.speckle(rng, height, width, 1, 3), (176, 130, 84))
    for _ in range(17):
        size = int(rng.integers(28, 62))
        x, y = int(rng.integers(4, width - size)), int(rng.integers(4, height - size))
        note = np.full((size, int(size * 0.9), 3), any_colour(rng, 170, 255), dtype=np.uint8)
        write_lines(rng, note, 0.3, (30, 30, 60), 0, size)
        picture[y : y + size, x : x + note.shape[1]] = note
        cv2.circle(picture, (x + size // 2, y + 4), 3, any_colour(rng, 0, 200), -1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (110, 80, 50), 7)
    return picture


def pegboard(rng: np.random.Generator, width: int = 384, height: int = 192) -> U8:
    """Draw a pale board of holes with tools hung on it."""
    picture = surfaces.tinted(1.0 + 0.015 * surfaces.speckle(rng, height, width, 1, 4), (206, 204, 196))
    for y in range(8, height, 12):
        for x in range(8, width, 12):
            cv2.circle(picture, (x, y), 1, (120, 118, 112), -1)
    for x in range(16, width - 20, 26):
        top, length, colour = int(rng.integers(10, height // 2)), int(rng.integers(40, 90)), any_colour(rng, 20, 190)
        cv2.line(picture, (x, top), (x, top + length), (70, 72, 76), int(rng.integers(3, 6)), cv2.LINE_AA)
        cv2.rectangle(picture, (x - 5, top + length // 2), (x + 5, top + length), colour, -1)
        head = x + int(rng.integers(-3, 4)), top
        cv2.ellipse(picture, head, (int(rng.integers(5, 11)), int(rng.integers(4, 8))), 0, 0, 360, (58, 60, 64), -1)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (150, 146, 138), 4)
    return picture


def desk_clutter(rng: np.random.Generator, width: int, height: int, colour: Rgb) -> U8:
    """Draw a desk top with papers, a keyboard and small things lying on it."""
    picture = surfaces.wood(rng, width, height, colour, 4)
    for _ in range(9):
        wide, tall = int(rng.integers(26, 60)), int(rng.integers(26, 60))
        x, y = int(rng.integers(0, max(1, width - wide))), int(rng.integers(0, max(1, height - tall)))
        sheet = np.full((tall, wide, 3), any_colour(rng, 195, 255), dtype=np.uint8)
        write_lines(rng, sheet, 0.3, (40, 40, 50), 0, tall)
        picture[y : y + tall, x : x + wide] = sheet
    for _ in range(2):
        x, y = int(rng.integers(0, max(1, width - 90))), int(rng.integers(0, max(1, height - 34)))
        cv2.rectangle(picture, (x, y), (x + 88, y + 32), (40, 40, 42), -1)
        for row in range(4):
            for key in range(12):
                at = x + 4 + 7 * key, y + 4 + 7 * row
                cv2.rectangle(picture, at, (at[0] + 4, at[1] + 4), (150, 150, 150), -1)
    for _ in range(8):
        spot = int(rng.integers(width)), int(rng.integers(height))
        cv2.circle(picture, spot, int(rng.integers(3, 9)), any_colour(rng), -1, cv2.LINE_AA)
    return picture
