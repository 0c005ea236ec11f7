"""The picture of the scene `dance`: our own ink silhouettes in the spirit of Picasso's "Rites of Spring".

`python -m symseek.scenes.dancers` draws `dance/dance.png` anew. Nothing of it is taken from any other picture.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter

FOLDER = Path(__file__).parent / "dance"
SIZE = (1000, 1600)
FINE = 4
"""Samples along each side of a pixel."""
INK = 1.6
"""How far ink runs together where strokes meet [px]."""

Points = list[tuple[float, ...]]

STROKES: dict[str, list[Points]] = {
    "piper": [
        [(204, 626, 40), (196, 556, 31), (206, 490, 37), (226, 446, 22)],  # trunk
        [(230, 440, 15), (246, 402, 21), (256, 366, 27), (258, 340, 22)],  # head
        [(228, 456, 20), (282, 520, 15), (306, 522, 14), (352, 452, 10), (366, 440, 8)],  # arms
        [(232, 448, 18), (304, 440, 13), (350, 414, 9), (372, 402, 8)],
        [(284, 388, 5), (344, 424, 6), (432, 480, 10)],  # pipes
        [(284, 384, 5), (362, 398, 6), (452, 416, 10)],
        [(206, 632, 38), (270, 624, 30), (328, 616, 22)],  # thighs and shins
        [(326, 612, 22), (334, 690, 17), (322, 770, 12), (330, 794, 10), (366, 806, 7)],
        [(200, 640, 34), (250, 672, 27), (286, 690, 20)],
        [(284, 684, 20), (268, 760, 16), (240, 824, 11), (248, 846, 10), (282, 858, 7)],
        [(92, 706, 34), (150, 696, 48), (214, 708, 34)],  # the stone he sits on
    ],
    "leaper": [
        [(566, 470, 34), (556, 404, 26), (570, 340, 34), (592, 300, 22)],
        [(594, 296, 13), (608, 262, 20), (618, 228, 25), (616, 206, 20)],
        [(586, 312, 18), (528, 272, 14), (494, 226, 11), (462, 164, 8), (456, 148, 8)],
        [(592, 314, 18), (658, 318, 14), (700, 278, 11), (724, 212, 9), (726, 196, 8)],
        [(560, 474, 32), (630, 512, 24), (656, 520, 18)],
        [(650, 514, 18), (640, 590, 14), (612, 640, 9), (620, 660, 8), (648, 668, 6)],
        [(556, 478, 31), (522, 556, 22), (486, 610, 16), (430, 646, 12), (398, 650, 9), (384, 672, 6)],
    ],
    "whirler": [
        [(880, 496, 46), (884, 424, 27), (880, 360, 33), (878, 318, 21)],
        [(878, 312, 12), (872, 278, 20), (866, 244, 26), (866, 222, 21)],
        [(868, 330, 17), (812, 320, 13), (784, 300, 12), (776, 232, 9), (782, 210, 8)],
        [(890, 332, 17), (952, 352, 13), (988, 330, 12), (1010, 270, 9), (1012, 252, 8)],
        [(860, 502, 32), (842, 580, 22), (850, 660, 14), (834, 716, 9), (812, 734, 7)],
        [(900, 502, 32), (934, 578, 22), (940, 640, 15), (972, 704, 9), (998, 716, 7)],
    ],
    "striker": [
        [(1226, 450, 36), (1240, 386, 28), (1230, 322, 35), (1212, 280, 22)],
        [(1210, 274, 13), (1196, 240, 20), (1186, 206, 25), (1188, 182, 20)],
        [(1214, 296, 18), (1150, 310, 13), (1114, 286, 11), (1084, 234, 8)],
        [(1224, 300, 18), (1286, 266, 14), (1306, 236, 12), (1296, 166, 9), (1290, 148, 8)],
        [(1220, 456, 32), (1156, 494, 23), (1128, 506, 17), (1140, 570, 12), (1132, 606, 9), (1106, 620, 6)],
        [(1234, 456, 32), (1276, 526, 22), (1286, 580, 15), (1310, 626, 10), (1338, 630, 7)],
    ],
    "goat": [
        [(470, 846, 42), (540, 838, 40), (610, 836, 44), (668, 826, 40)],
        [(664, 830, 34), (706, 786, 26), (728, 748, 24), (764, 748, 19), (800, 766, 12)],
        [(730, 738, 11), (736, 700, 10), (716, 664, 8), (680, 650, 4)],
        [(746, 738, 10), (768, 698, 9), (760, 656, 7), (734, 628, 4)],
        [(752, 766, 8), (750, 796, 8), (742, 820, 3)],  # beard
        [(664, 850, 24), (694, 896, 14), (690, 940, 9), (704, 972, 8)],
        [(640, 856, 24), (640, 900, 14), (626, 940, 9), (634, 974, 8)],
        [(496, 856, 26), (516, 900, 15), (500, 938, 9), (512, 974, 8)],
        [(462, 852, 26), (444, 898, 15), (456, 938, 9), (436, 974, 8)],
        [(438, 826, 14), (412, 796, 10), (402, 772, 5)],
    ],
    "ram": [
        [(1104, 890, 42), (1134, 838, 38), (1154, 790, 40), (1174, 752, 36)],
        [(1172, 752, 28), (1170, 706, 22), (1154, 676, 21), (1122, 674, 17), (1096, 690, 11)],
        [(1164, 668, 11), (1196, 644, 10), (1224, 662, 8), (1228, 696, 4)],
        [(1150, 666, 10), (1160, 628, 9), (1190, 604, 7), (1228, 606, 4)],
        [(1164, 762, 22), (1104, 744, 14), (1052, 754, 10), (1026, 780, 8)],
        [(1150, 806, 22), (1092, 812, 14), (1044, 836, 10), (1030, 874, 8)],
        [(1098, 898, 28), (1070, 932, 16), (1080, 962, 10), (1058, 982, 8)],
        [(1114, 904, 26), (1140, 938, 15), (1132, 964, 10), (1156, 982, 8)],
        [(1132, 900, 14), (1174, 894, 11), (1204, 862, 5)],
    ],
    "tumbler": [
        [(1462, 700, 33), (1450, 768, 26), (1462, 826, 30), (1484, 860, 20)],
        [(1486, 862, 13), (1500, 890, 19), (1506, 918, 22), (1502, 936, 17)],
        [(1476, 850, 17), (1424, 872, 13), (1398, 912, 10), (1392, 966, 8)],
        [(1490, 850, 17), (1546, 866, 13), (1566, 908, 10), (1564, 962, 8)],
        [(1450, 700, 30), (1402, 684, 22), (1372, 694, 16), (1350, 744, 11), (1318, 758, 7)],
        [(1470, 692, 30), (1490, 616, 22), (1516, 560, 15), (1548, 500, 10), (1574, 488, 7)],
    ],
    "dove": [
        [(932, 122, 5), (970, 112, 17), (1010, 106, 20), (1044, 90, 14), (1068, 82, 4)],
        [(1004, 100, 15), (986, 66, 14), (954, 34, 5)],
        [(1002, 112, 15), (1018, 150, 13), (1004, 192, 5)],
    ],
}
"""For each figure brush strokes: points (column, row, half width), px."""

PATCHES: dict[str, list[Points]] = {
    "piper": [
        [(276, 356), (292, 384), (272, 396), (256, 384)],  # face
        [(232, 334), (250, 306), (276, 318), (270, 346), (240, 356)],  # wreath
    ],
    "leaper": [[(640, 224), (654, 240), (636, 256), (620, 240)], [(594, 214), (570, 232), (578, 262), (606, 250)]],
    "whirler": [
        [(842, 236), (828, 254), (846, 270), (862, 252)],
        [(888, 226), (912, 250), (900, 290), (882, 270)],
        [(846, 452), (806, 540), (860, 566), (926, 560), (948, 530), (912, 452)],  # skirt
    ],
    "striker": [[(1164, 200), (1150, 216), (1166, 232), (1182, 216)], [(1204, 186), (1230, 204), (1226, 246), (1204, 226)]],
    "goat": [[(716, 742), (690, 728), (700, 756)]],
    "ram": [[(1170, 694), (1204, 692), (1182, 714)]],
    "tumbler": [[(1526, 908), (1540, 926), (1520, 940), (1508, 922)]],
}
"""And smooth outlines, points (column, row), px: faces, hair, ears, a skirt."""


@cache
def figure(name: str) -> np.ndarray:
    """Share of each pixel that a figure covers, float32, shape SIZE."""
    discs = np.concatenate([_brush(np.array(stroke)) for stroke in STROKES[name]])
    patches = [_outline(np.array(patch)) for patch in PATCHES.get(name, [])]
    corners = np.concatenate([discs[:, :2] - discs[:, 2:], discs[:, :2] + discs[:, 2:], *patches])
    left, top = np.maximum(np.floor(corners.min(axis=0)) - 4 * INK, 0).astype(int)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)) + 4 * INK + 1, SIZE[::-1]).astype(int)
    sheet = Image.new("L", ((right - left) * FINE, (bottom - top) * FINE))
    pen = ImageDraw.Draw(sheet)

    def samples(points: np.ndarray) -> np.ndarray:
        return (points - [left, top]) * FINE + FINE / 2 - 0.5  # pixel centres lie at whole numbers

    for (x, y), r in zip(samples(discs[:, :2]), discs[:, 2] * FINE, strict=True):
        pen.ellipse((x - r, y - r, x + r, y + r), fill=255)
    for patch in patches:
        pen.polygon([(float(x), float(y)) for x, y in samples(patch)], fill=255)
    ink = gaussian_filter(np.asarray(sheet, np.float32), INK * FINE) > 127.5
    out = np.zeros(SIZE, np.float32)
    out[top:bottom, left:right] = ink.reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3))
    return out


def _brush(stroke: np.ndarray) -> np.ndarray:
    """Discs (column, row, radius) along a stroke, px."""
    arc = np.append(0, np.cumsum(np.hypot(*np.diff(stroke[:, :2], axis=0).T)))
    fine = np.linspace(0, arc[-1], int(FINE * arc[-1]))
    return np.column_stack([CubicSpline(arc, stroke[:, :2])(fine), PchipInterpolator(arc, stroke[:, 2])(fine)])


def _outline(points: np.ndarray) -> np.ndarray:
    """A smooth closed curve through points, px."""
    closed = np.concatenate([points, points[:1]])
    arc = np.append(0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    return CubicSpline(arc, closed, bc_type="periodic")(np.linspace(0, arc[-1], int(FINE * arc[-1])))


def picture() -> np.ndarray:
    """The dance in black on white, float32 in [0, 1], shape SIZE."""
    return 1 - np.max([figure(name) for name in STROKES], axis=0)


if __name__ == "__main__":
    grey = np.uint8(np.round(255 * picture()))
    Image.fromarray(grey).save(FOLDER / "dance.png", optimize=True)
