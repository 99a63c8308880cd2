"""Head models that tests share: one of each kind."""

from hmdjit.head_motion import Amplitude, HeadMotion, Resonator

_TRACKER = (0.0037, 0.0036, 0.0034)


def models(*, person_sd, scale=1.0, wander_s=15.0):
    """Model A, model B with two resonances, and the latter with bursts, by name.

    Speeds are about 1 deg/s times `scale`; `wander_s` is model A's return time.
    """

    def speeds(*values):
        return tuple(scale * value for value in values)

    model_a = HeadMotion(
        speeds(1.12, 0.91, 0.93), (0.10, 0.124, 0.029), _TRACKER, wander_s, person_sd
    )
    model_b = HeadMotion(
        speeds(0.9, 0.6, 0.65),
        (0.15, 0.23, 0.05),
        _TRACKER,
        return_time_s=4.0,
        person_sd=person_sd,
        resonators=(
            Resonator(speeds(0.4, 0.5, 0.5), (2.8, 2.4, 3.0), (0.12, 0.05, 1.2)),
            Resonator(speeds(0.45, 0.35, 0.3), (8.0, 4.1, 11.4), (0.15, 0.07, 0.1)),
        ),
    )
    bursts = HeadMotion(**{**vars(model_b), "amplitude": Amplitude(0.3, 0.4)})
    return {"A": model_a, "B": model_b, "bursts": bursts}
