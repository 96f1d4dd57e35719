"""Textures of people: shirts, trousers, skin, faces, shoes. u runs round the body (0.5 is the front), v down."""

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, U8, Bool, Floats
from stillroom_scenes.scene import surfaces
from stillroom_scenes.scene.pictures import WORDS, any_colour
from stillroom_scenes.scene.surfaces import Rgb

SKINS: tuple[Rgb, ...] = ((226, 178, 150), (196, 142, 110), (140, 94, 68), (238, 196, 172))
HAIRS: tuple[Rgb, ...] = ((44, 32, 26), (92, 62, 38), (26, 24, 24), (150, 116, 70))
SHIRTS: tuple[Rgb, ...] = ((46, 66, 116), (150, 52, 50), (86, 92, 76), (200, 196, 188), (50, 112, 100), (206, 168, 70))
JEANS: tuple[Rgb, ...] = ((58, 76, 118), (46, 50, 66), (96, 88, 76), (74, 96, 140))


def folds(rng: np.random.Generator, height: int, width: int, depth: float) -> F32:
    """Return the light and dark of creases (H, W), around 1, that run mostly across the limb."""
    values = np.ones((height, width), dtype=np.float32)
    for cells_down, cells_across, share in ((7, 3, 0.6), (15, 6, 0.45), (4, 9, 0.4)):
        coarse = rng.standard_normal((cells_down, cells_across)).astype(np.float32)
        values += depth * share * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return values


def shirt(rng: np.random.Generator, style: str, colour: Rgb, size_px: int = 256) -> U8:
    """Draw the cloth of a shirt: "plaid", "stripes", "print" or "knit"; anything else is plain."""
    values = folds(rng, size_px, size_px, 0.14) + 0.05 * surfaces.speckle(rng, size_px, size_px, 1, 3)
    picture = np.empty((size_px, size_px, 3), dtype=np.uint8)
    picture[:] = colour
    draw = {"plaid": _plaid, "stripes": _stripes, "print": _print, "knit": _knit}.get(style)
    if draw is not None:
        draw(rng, picture, _between(colour, contrasting(rng, colour), 0.28))
    return np.clip(picture * values[..., None], 0, 255).astype(np.uint8)


def contrasting(rng: np.random.Generator, colour: Rgb) -> Rgb:
    """Return a colour that stands out: light on dark, dark on light."""
    return any_colour(rng, 165, 235) if sum(colour) < 390 else any_colour(rng, 20, 90)


def _between(one: Rgb, other: Rgb, share: float) -> Rgb:
    red, green, blue = (int((1 - share) * a + share * b) for a, b in zip(one, other, strict=True))
    return red, green, blue


def _plaid(rng: np.random.Generator, cloth: U8, ink: Rgb) -> None:
    """Draw broad bands both ways, and a thin line beside each."""
    size, step = len(cloth), int(rng.integers(24, 34))
    for low in range(0, size, step):
        for band in (cloth[low : low + step // 3], cloth[:, low : low + step // 3]):
            band[:] = (0.4 * band + 0.6 * np.array(ink)).astype(np.uint8)
        for line in (cloth[low + 2 * step // 3 :][:2], cloth[:, low + 2 * step // 3 :][:, :2]):
            line[:] = (0.6 * line).astype(np.uint8)


def _stripes(rng: np.random.Generator, cloth: U8, ink: Rgb) -> None:
    """Draw stripes round the body, of uneven width."""
    size, step = len(cloth), int(rng.integers(16, 26))
    for top in range(0, size, step):
        band = cloth[top : top + int(rng.integers(step // 3, 2 * step // 3))]
        band[:] = (0.35 * band + 0.65 * np.array(ink)).astype(np.uint8)


def _knit(rng: np.random.Generator, cloth: U8, ink: Rgb) -> None:
    """Draw a jumper with rows of diamonds, crosses and dots."""
    size, step = len(cloth), 22
    for number, y in enumerate(range(step // 2, size, step)):
        offset = int(rng.integers(step))
        for x in range(offset, size + step, step):
            kind, reach = number % 3, int(rng.integers(5, 8))
            if kind == 0:
                corners = np.array([[x - reach, y], [x, y - reach], [x + reach, y], [x, y + reach]], dtype=np.int32)
                cv2.fillPoly(cloth, [corners], ink, cv2.LINE_AA)
            elif kind == 1:
                cv2.line(cloth, (x - reach, y - reach), (x + reach, y + reach), ink, 2, cv2.LINE_AA)
                cv2.line(cloth, (x - reach, y + reach), (x + reach, y - reach), ink, 2, cv2.LINE_AA)
            else:
                cv2.circle(cloth, (x, y), reach // 2, ink, -1, cv2.LINE_AA)


def _print(rng: np.random.Generator, cloth: U8, ink: Rgb) -> None:
    """Put letters and a badge on breast and back, smaller ones at the sides."""
    size = len(cloth)
    for centre in (size // 2, 0, size):
        cv2.circle(cloth, (centre, int(0.36 * size)), size // 10, ink, 3, cv2.LINE_AA)
        for _ in range(9):
            spot = centre + int(rng.integers(-24, 24)), int(0.36 * size) + int(rng.integers(-22, 22))
            cv2.circle(cloth, spot, int(rng.integers(2, 6)), any_colour(rng), -1, cv2.LINE_AA)
        for row in range(3):
            at = centre - 34, int((0.55 + 0.11 * row) * size)
            cv2.putText(cloth, str(rng.choice(WORDS)).upper(), at, cv2.FONT_HERSHEY_DUPLEX, 0.72, ink, 2, cv2.LINE_AA)
    for u in (0.25, 0.75):
        for row in range(9):
            at = int(u * size) - 16, 30 + 24 * row
            cv2.putText(cloth, str(rng.choice(WORDS)), at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, 1, cv2.LINE_AA)


def trousers(rng: np.random.Generator, colour: Rgb, width: int = 128, height: int = 256) -> U8:
    """Draw a leg of jeans: worn thigh, seams, creases at knee and ankle."""
    values = folds(rng, height, width, 0.13) + 0.09 * surfaces.speckle(rng, height, width, 1, 4)
    worn = np.exp(-(((np.arange(width) / width - 0.5) / 0.16) ** 2))[None, :]
    values += (0.22 * worn * np.exp(-(((np.arange(height) / height - 0.3) / 0.28) ** 2))[:, None]).astype(np.float32)
    for centre, count in ((0.52, 4), (0.93, 6)):
        for k in range(count):
            row = int(height * (centre + 0.018 * (k - count / 2)))
            values[row : row + 2] *= float(rng.uniform(0.75, 0.95))
    cloth = surfaces.tinted(values, colour)
    seam = tuple(min(255, c + 55) for c in colour)
    for u in (0.25, 0.75):
        x = int(u * width)
        cloth[:, x : x + 1] = (cloth[:, x : x + 1] * 0.6).astype(np.uint8)
        cloth[::3, x + 2] = seam
    return cloth


def waist(rng: np.random.Generator, colour: Rgb, size_px: int = 128) -> U8:
    """Draw the seat of the trousers with belt, pockets and fly."""
    cloth = surfaces.tinted(folds(rng, size_px, size_px, 0.1) + 0.05 * surfaces.speckle(rng, size_px, size_px), colour)
    dark = tuple(int(0.6 * c) for c in colour)
    for u in (0.08, 0.92):
        x = int(u * size_px)
        cv2.rectangle(cloth, (x - 9, 50), (x + 9, 82), dark, 1, cv2.LINE_AA)
    for u, lean in ((0.36, -8), (0.64, 8)):
        cv2.line(cloth, (int(u * size_px), 30), (int(u * size_px) + lean, 62), dark, 2, cv2.LINE_AA)
    cv2.line(cloth, (size_px // 2, 26), (size_px // 2, 90), dark, 1)
    cloth[10:24] = (40, 30, 24)
    cv2.rectangle(cloth, (size_px // 2 - 6, 10), (size_px // 2 + 6, 23), (190, 180, 140), 2)
    return cloth


def skin(rng: np.random.Generator, colour: Rgb, size_px: int = 64) -> U8:
    """Draw bare skin."""
    return surfaces.tinted(1.0 + 0.03 * surfaces.speckle(rng, size_px, size_px, 1, 4), colour)


def shoe(rng: np.random.Generator, size_px: int = 64) -> U8:
    """Draw a shoe: dark upper, laces in front, pale sole."""
    colour = any_colour(rng, 20, 90)
    picture = surfaces.tinted(1.0 + 0.1 * surfaces.speckle(rng, size_px, size_px, 1, 3), colour)
    for row in range(8, int(0.6 * size_px), 7):
        picture[row : row + 2, int(0.44 * size_px) : int(0.56 * size_px)] = 220
    picture[int(0.82 * size_px) :] = (205, 202, 196)
    return picture


def head(rng: np.random.Generator, skin_colour: Rgb, hair_colour: Rgb, beard: bool, size_px: int = 256) -> U8:
    """Draw neck, face and hair, unrolled: v = 0 is the crown, 1 the foot of the neck."""
    s = size_px
    picture = surfaces.tinted(1.0 + 0.02 * surfaces.speckle(rng, s, s, 1, 4), skin_colour)
    hair = surfaces.tinted(1.0 + 0.22 * _strands(rng, s), hair_colour)
    grown = hair_mask(np.linspace(0, 1, s)[None, :], np.linspace(0, 1, s)[:, None])
    picture[grown] = hair[grown]
    shadow = tuple(int(0.66 * c) for c in skin_colour)
    lip = int(0.78 * skin_colour[0]), int(0.5 * skin_colour[1]), int(0.5 * skin_colour[2])
    if beard:
        cv2.ellipse(picture, (s // 2, int(0.69 * s)), (int(0.14 * s), int(0.11 * s)), 0, 0, 360, hair_colour, -1)
        cv2.ellipse(picture, (s // 2, int(0.63 * s)), (int(0.075 * s), int(0.05 * s)), 0, 0, 360, skin_colour, -1)
    for side in (-1, 1):
        x, y = int((0.5 + side * 0.066) * s), int(0.435 * s)
        cv2.ellipse(picture, (x, y), (int(0.042 * s), int(0.034 * s)), 0, 0, 360, shadow, -1, cv2.LINE_AA)
        cv2.ellipse(picture, (x, y), (int(0.029 * s), int(0.013 * s)), 0, 0, 360, (240, 238, 232), -1, cv2.LINE_AA)
        cv2.circle(picture, (x, y), int(0.013 * s), (40, 30, 26), -1, cv2.LINE_AA)
        brow = (x - int(0.04 * s), y - int(0.042 * s)), (x + int(0.04 * s), y - int(0.048 * s))
        cv2.line(picture, *brow, hair_colour, max(2, s // 60), cv2.LINE_AA)
        nostril = int((0.5 + side * 0.016) * s), int(0.563 * s)
        cv2.circle(picture, nostril, max(2, s // 110), shadow, -1, cv2.LINE_AA)
        cv2.line(
            picture,
            (int((0.5 + side * 0.022) * s), int(0.47 * s)),
            (int((0.5 + side * 0.03) * s), int(0.56 * s)),
            shadow,
            1,
        )
    cv2.ellipse(picture, (s // 2, int(0.63 * s)), (int(0.05 * s), int(0.014 * s)), 0, 0, 360, lip, -1, cv2.LINE_AA)
    cv2.line(picture, (int(0.455 * s), int(0.63 * s)), (int(0.545 * s), int(0.63 * s)), (90, 50, 46), 1, cv2.LINE_AA)
    picture[int(0.78 * s) :] = (picture[int(0.78 * s) :] * 0.72).astype(np.uint8)  # the chin's shadow
    return picture


def hair_mask(u: Floats, v: Floats) -> Bool:
    """Return where on the unrolled head hair grows: above a line that is high over the face and low at the nape."""
    from_front = np.abs(np.asarray(u) - 0.5) * 2.0
    line = (
        0.27 + 0.05 * np.cos(7.0 * from_front) * (from_front < 0.45) + 0.42 * np.clip((from_front - 0.36) / 0.3, 0, 1)
    )
    return np.asarray(np.asarray(v) < line, dtype=np.bool_)


def _strands(rng: np.random.Generator, size_px: int) -> F32:
    fine = rng.standard_normal((8, size_px)).astype(np.float32)
    return np.asarray(cv2.resize(fine, (size_px, size_px), interpolation=cv2.INTER_LINEAR), dtype=np.float32)
