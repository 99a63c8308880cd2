"""Periodograms of recorded head velocities, and what a model's would be.

Recorded frame differences are cut into windows of 4 s, half overlapping and tapered by
a Hann window. Where a headset lost frames the turn between its neighbours is spread
evenly over them; a window's *leakage* carries any spectrum to the periodogram that it
is expected to give, taper, finite length and lost frames included. So the likelihood
of a spectrum is unbiased for gappy recordings too (debiased Whittle likelihood:
Sykulski et al., Biometrika 106(2), 2019).

Arrays are NumPy float64; axes ordered pitch, yaw, roll.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int
from scipy.spatial.transform import Rotation

from ..head_motion.trace import Trace

WINDOW_S = 4.0
LOWEST_HZ = 0.25  # one period of a window
HIGHEST_SHARE = 0.97  # of the Nyquist frequency


class Turns(NamedTuple):
    """Frame-to-frame rotation of a recorded segment, on its grid of frames.

    - `angle_deg`: rotation vector of each recorded step, deg, head frame.
    - `frames`: how many frames each step spans, 1 where none was lost.
    - `rate_hz`: frames per second, Hz.
    """

    angle_deg: Float64[np.ndarray, "steps 3"]
    frames: Int[np.ndarray, " steps"]
    rate_hz: float

    @classmethod
    def of(cls, segment: Trace) -> "Turns":
        """Measure the turns of a segment without gaps."""
        head = Rotation.from_quat(segment.world_from_head, scalar_first=True)
        turned = (head[:-1].inv() * head[1:]).as_rotvec(degrees=True)
        return cls(turned, np.diff(segment.frame_numbers), segment.rate_hz)

    @property
    def velocity_deg_s(self) -> Float64[np.ndarray, "steps 3"]:
        """Mean angular velocity of each recorded step, deg/s."""
        return self.angle_deg * (self.rate_hz / self.frames)[:, None]

    @property
    def filled_deg(self) -> Float64[np.ndarray, "frames 3"]:
        """Turn of each frame, deg; a step over lost frames is spread evenly."""
        return np.repeat(self.angle_deg / self.frames[:, None], self.frames, axis=0)

    @property
    def path_deg(self) -> Float64[np.ndarray, "frames 3"]:
        """Angle of each frame from the first, deg: the sum of the turns."""
        start = np.zeros((1, 3))
        return np.concatenate([start, np.cumsum(self.filled_deg, axis=0)])


class Periodograms(NamedTuple):
    """Periodograms of windows, each of one subject.

    - `frequency_hz`: where they are taken.
    - `power`: one-sided densities of the velocity, (deg/s)^2/Hz.
    - `subject`: index of each window's subject in `subjects`.
    - `steps`: frames that each recorded step of a window spans.
    """

    rate_hz: float
    frequency_hz: Float64[np.ndarray, " freqs"]
    power: Float64[np.ndarray, "windows freqs 3"]
    subject: Int[np.ndarray, " windows"]
    subjects: tuple[str, ...]
    steps: list[np.ndarray]

    @classmethod
    def of(cls, segments: Sequence[Trace], rate_hz: float) -> "Periodograms":
        """Take periodograms of all windows of segments that share a frame rate.

        Segments shorter than a window give none.
        """
        count, taper, kept, frequency_hz = _window(rate_hz)
        power, owner, all_steps = [], [], []
        for segment in segments:
            turns = Turns.of(segment)
            velocity = turns.filled_deg * rate_hz
            step_of = np.repeat(np.arange(len(turns.frames)), turns.frames)
            for start in range(0, len(velocity) - count + 1, count // 2):
                window = slice(start, start + count)
                waves = np.fft.rfft(taper[:, None] * velocity[window], axis=0)[kept]
                power.append(2 / rate_hz * np.abs(waves) ** 2)
                all_steps.append(np.unique(step_of[window], return_counts=True)[1])
                owner.append(segment.subject)
        subjects = tuple(sorted(set(owner)))
        return cls(
            rate_hz,
            frequency_hz,
            np.array(power).reshape(-1, len(kept), 3),
            np.array([subjects.index(name) for name in owner], int),
            subjects,
            all_steps,
        )

    @property
    def windows(self) -> Int[np.ndarray, " subjects"]:
        """How many windows each subject has."""
        return np.bincount(self.subject, minlength=len(self.subjects))

    def by_subject(self) -> Float64[np.ndarray, "subjects freqs 3"]:
        """Mean periodogram of each subject."""
        numbers = range(len(self.subjects))
        return np.stack([self.power[self.subject == i].mean(axis=0) for i in numbers])

    def in_blocks(self, count: int) -> "Periodograms":
        """Return the same windows in blocks, each as if of a subject of its own."""
        order = np.argsort(self.subject, kind="stable")
        block = np.empty(len(order), int)
        block[order] = np.arange(len(order)) * count // len(order)
        subjects = tuple(f"block {i + 1}" for i in range(count))
        return self._replace(subject=block, subjects=subjects)

    @property
    def grid_hz(self) -> Float64[np.ndarray, " grid"]:
        """Where a spectrum must be known to expect a periodogram, Hz."""
        return np.fft.rfftfreq(_grid(self.rate_hz), 1 / self.rate_hz)

    def leakage(self) -> Float64[np.ndarray, "subjects freqs grid"]:
        """Mean leakage of each subject's windows.

        The subject's expected periodogram is `leakage @ spectrum(grid_hz)`.
        """
        count, taper, kept, _ = _window(self.rate_hz)
        waves = np.exp(-2j * np.pi * np.outer(kept, np.arange(count)) / count)
        waves *= taper
        grid = _grid(self.rate_hz)
        whole = _leakage(waves, np.ones(count, int), grid)
        mean = np.zeros((len(self.subjects), len(kept), grid // 2 + 1))
        for subject, steps in zip(self.subject, self.steps, strict=True):
            is_whole = len(steps) == count
            mean[subject] += whole if is_whole else _leakage(waves, steps, grid)
        return mean / self.windows[:, None, None]


def _window(rate_hz: float) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Frames of a window, its taper, the indices of its frequencies, and those."""
    count = round(WINDOW_S * rate_hz)
    taper = np.hanning(count + 1)[:-1]
    frequency_hz = np.fft.rfftfreq(count, 1 / rate_hz)
    is_low = frequency_hz < LOWEST_HZ * (1 - 1e-6)
    is_high = frequency_hz > HIGHEST_SHARE * rate_hz / 2
    kept = np.flatnonzero(~is_low & ~is_high)
    return count, taper / np.sqrt(np.sum(taper**2)), kept, frequency_hz[kept]


def _grid(rate_hz: float) -> int:
    # Covariances are taken for those of a process that repeats after 12 s: within a
    # window those beyond 8 s overlap. Of a head only the spring's are left there; they
    # take 1 % (return time 4 s) to 5 % (15 s) from what is expected at 0.25 Hz.
    return 3 * round(WINDOW_S * rate_hz) // 2 * 2


def _leakage(
    waves: np.ndarray, steps: Int[np.ndarray, " steps"], grid: int
) -> Float64[np.ndarray, "freqs grid"]:
    """Leakage of a window whose recorded steps span so many frames each."""
    # The filled series averages over each step, so its waves see the true turns through
    # the same averages.
    starts = np.concatenate([[0], np.cumsum(steps)[:-1]])
    mean = np.add.reduceat(waves, starts, axis=1) / steps
    seen = np.repeat(mean, steps, axis=1)
    two_sided = np.abs(np.fft.fft(seen, grid, axis=1)) ** 2 / grid
    one_sided = two_sided[:, : grid // 2 + 1]
    one_sided[:, 1 : grid // 2] += two_sided[:, : grid // 2 : -1]
    return one_sided
