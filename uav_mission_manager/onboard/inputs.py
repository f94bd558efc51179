"""What may be wrong with an input."""


class InputError(ValueError):
    """A refused input: one line naming topic, field and value."""
