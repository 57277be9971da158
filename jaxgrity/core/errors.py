"""The one error that users meet: bad input, refused in one line before anything compiles."""


class InputError(ValueError):
    """A scene, a gait or an option that cannot be simulated: what, where, the value received, what was expected."""
