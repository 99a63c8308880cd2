"""FXAA, pixel by pixel and read by read: the white paper's version, and 3.11."""

import math

import numpy as np

TIE = 1e-5
STEPS = {
    "10": [1.5, 3, 12],
    "12": [1, 1.5, 2, 4, 12],
    "15": [1, 1.5, 2, 2, 2, 2, 4, 12],
    "29": [1, 1.5, 2, 2, 2, 2, 2, 2, 2, 2, 4, 8],
    "39": [1, 1, 1, 1, 1, 1.5, 2, 2, 2, 2, 4, 8],
}


def decoded(gamma):
    return np.where(gamma <= 0.04045, gamma / 12.92, ((gamma + 0.055) / 1.055) ** 2.4)


def encoded(linear):
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


class Picture:
    """A plane as lists, read with clamped edges."""

    def __init__(self, plane):
        self.rows = plane.tolist()
        self.height, self.width = plane.shape

    def at(self, x, y):
        x = min(max(x, 0), self.width - 1)
        return self.rows[min(max(y, 0), self.height - 1)][x]

    def bilinear(self, x, y):
        """Between pixel centres, which lie at whole numbers."""
        left, top = math.floor(x), math.floor(y)
        fx, fy = x - left, y - top
        upper = self.at(left, top) * (1 - fx) + self.at(left + 1, top) * fx
        lower = self.at(left, top + 1) * (1 - fx) + self.at(left + 1, top + 1) * fx
        return upper * (1 - fy) + lower * fy


def fxaa(image, preset="white_paper", space="gamma"):
    """Picture `(3, height, width)`, and by how little each pixel's decisions were made.

    The second is the least distance of two numbers that were compared.
    """
    red, green, blue = image
    is_first = preset == "white_paper"
    if is_first:
        luma = Picture(red + 1.963211 * green)
    else:
        luma = Picture(0.299 * red + 0.587 * green + 0.114 * blue)
    colors = [Picture(p) for p in (decoded(image) if space == "linear" else image)]
    shown, margins = image.copy(), np.empty(image.shape[1:])
    for y in range(luma.height):
        for x in range(luma.width):
            pixel = Pixel(luma, x, y)
            mixed = (pixel.first if is_first else pixel.second)(colors, preset)
            if mixed is not None:
                mixed = np.array(mixed)
                shown[:, y, x] = encoded(mixed) if space == "linear" else mixed
            margins[y, x] = pixel.margin
    return shown, margins


class Pixel:
    def __init__(self, luma, x, y):
        self.luma, self.x, self.y = luma, x, y
        self.margin = math.inf
        near = [[luma.at(x + i, y + j) for i in (-1, 0, 1)] for j in (-1, 0, 1)]
        (self.nw, self.n, self.ne), (self.w, self.m, self.e), last = near
        self.sw, self.s, self.se = last
        plus = self.m, self.n, self.s, self.w, self.e
        self.largest, self.range = max(plus), max(plus) - min(plus)

    def at_least(self, one, other):
        """Whether `one >= other`, or as good as equal."""
        self.margin = min(self.margin, abs(one - other + TIE))
        return one >= other - TIE

    def below_zero(self, value):
        self.margin = min(self.margin, abs(value + TIE))
        return value < -TIE

    def side(self, is_level):
        """Step to the side of the edge, the luma there, and the larger gradient."""
        one, other = (self.n, self.s) if is_level else (self.w, self.e)
        before, after = abs(one - self.m), abs(other - self.m)
        is_before = self.at_least(before, after)
        step = -1 if is_before else 1
        across = (0, step) if is_level else (step, 0)
        return across, one if is_before else other, max(before, after)

    def walk(self, across, sign, average, enough, steps):
        """Distance and luma less the average, of one end."""
        along = (abs(across[1]) * sign, abs(across[0]) * sign)
        distance, change = 0, 0.0
        for step in steps[:-1]:
            distance += step
            x = self.x + across[0] / 2 + along[0] * distance
            y = self.y + across[1] / 2 + along[1] * distance
            change = self.luma.bilinear(x, y) - average
            if self.at_least(abs(change), enough):
                return distance, change
        return distance + steps[-1], change

    def offset(self, across, side, enough, steps):
        average = (self.m + side) / 2
        negative, at_negative = self.walk(across, -1, average, enough, steps)
        positive, at_positive = self.walk(across, 1, average, enough, steps)
        end = at_negative if negative < positive else at_positive
        if self.below_zero(self.m - average) == self.below_zero(end):
            return 0.0
        return 0.5 - min(negative, positive) / (negative + positive)

    def moved(self, colors, across, offset):
        x, y = self.x + across[0] * offset, self.y + across[1] * offset
        return [color.bilinear(x, y) for color in colors]

    def first(self, colors, _):
        """Follow the white paper, steps 1 to 8."""
        if not self.at_least(self.range, max(1 / 24, self.largest / 8)):
            return None
        apart = abs((self.n + self.s + self.e + self.w) / 4 - self.m)
        share = min(3 / 4, max(0, apart / self.range - 1 / 4) * 4 / 3)
        rows = abs(self.nw / 4 - self.n / 2 + self.ne / 4)
        rows += abs(self.w / 2 - self.m + self.e / 2)
        rows += abs(self.sw / 4 - self.s / 2 + self.se / 4)
        columns = abs(self.nw / 4 - self.w / 2 + self.sw / 4)
        columns += abs(self.n / 2 - self.m + self.s / 2)
        columns += abs(self.ne / 4 - self.e / 2 + self.se / 4)
        across, side, _ = self.side(self.at_least(columns, rows))
        enough = abs(side - self.m) / 4
        offset = self.offset(across, side, enough, [1] * 33)
        moved = self.moved(colors, across, offset)
        places = [(self.x + i, self.y + j) for j in (-1, 0, 1) for i in (-1, 0, 1)]
        box = [sum(color.at(*place) for place in places) / 9 for color in colors]
        return [m * (1 - share) + b * share for m, b in zip(moved, box, strict=True)]

    def second(self, colors, preset):
        """Follow version 3.11, steps 1 to 7."""
        share, least = (0.063, 0.0312) if preset == "39" else (0.166, 0.0833)
        if not self.at_least(self.range, max(least, self.largest * share)):
            return None
        columns = abs(self.nw + self.sw - 2 * self.w)
        columns += 2 * abs(self.n + self.s - 2 * self.m)
        columns += abs(self.ne + self.se - 2 * self.e)
        rows = abs(self.nw + self.ne - 2 * self.n)
        rows += 2 * abs(self.w + self.e - 2 * self.m)
        rows += abs(self.sw + self.se - 2 * self.s)
        low = 2 * (self.n + self.s + self.e + self.w)
        low = (low + self.nw + self.ne + self.sw + self.se) / 12
        apart = min(abs(low - self.m) / self.range, 1)
        subpixel = (apart**2 * (3 - 2 * apart)) ** 2 * 0.75
        across, side, gradient = self.side(self.at_least(columns, rows))
        offset = self.offset(across, side, gradient / 4, STEPS[preset])
        return self.moved(colors, across, max(offset, subpixel))
