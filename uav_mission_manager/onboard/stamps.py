"""The age of a message by its own stamp."""

from __future__ import annotations

from uav_mission_manager.onboard.inputs import InputError


def stamp_age(topic: str, stamp: float | None, clock: float, timeout: float) -> float:
    """Return how old a message is.

    Parameters
    ----------
    topic : str
        Where it came from.
    stamp : float or None
        Time [s] at which its sender says that it was made; None or 0 if it does not say.
    clock : float
        The same clock's time [s], here and now.
    timeout : float
        Age [s] above which it is not believed, nor from so far in the future.

    Returns
    -------
    float
        [s], not below 0; 0 where the sender does not say.

    Raises
    ------
    InputError
        If it is not believed.
    """
    if not stamp:
        return 0.0
    age = clock - stamp
    if age > timeout:
        raise InputError(f'{topic}: stamped {age:.1f} s ago, more than {timeout:.1f} s')
    if not age >= -timeout:  # Nor a stamp that is not a number.
        raise InputError(f'{topic}: stamped {-age:.1f} s ahead of the clock here')
    return max(age, 0.0)
