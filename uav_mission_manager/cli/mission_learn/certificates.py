"""What is certified of the expansions of an old and a new mission."""

from __future__ import annotations

from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy import build_policy
from uav_mission_manager.policy.certificate import Certificate, gap_text, worsening

GAPS = {
    'gap': 'mean gap over all states',
    'flown_gap': 'mean gap over the states that are flown',
    'largest_gap': 'largest gap of a state',
}
"""What a certificate says, in words."""


def certificate_lines(old: Mission, new: Mission) -> list[str]:
    """Build both, and say each gap before and after; a larger one is a warning."""
    before, after = (_certificate(mission) for mission in (old, new))
    return compared(before, after)


def compared(before: Certificate, after: Certificate) -> list[str]:
    """Return a line for each gap, and a warning for each that is larger now."""
    lines = []
    for name, words in GAPS.items():
        was, now = getattr(before, name), getattr(after, name)
        lines.append(f'Certified {words}: {gap_text(was)} before, {gap_text(now)} after.')
        if worse := worsening(words, was, now):
            lines.append(
                f'WARNING: with the new numbers {worse}: a higher --order of policy_build may '
                'mend it.'
            )
    return lines


def _certificate(mission: Mission) -> Certificate:
    certificate = build_policy(mission, 'expansion', certificate=True).certificate
    assert certificate is not None
    return certificate
