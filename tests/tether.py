"""An effect of a user, as text of a plugin's file."""

TETHER = '''
"""A spring to a fixed point."""

from stringcast.stages.model.effect import Parameter, StringEffect


class Tether(StringEffect):
    """Pull each mass point to a point, with strength times distance."""

    name = "tether"
    parameters = (
        Parameter("strength", "1/s2", "pull over mass and distance", 0.0, 60.0, 0.0),
    )
    reference = "Hooke's law"

    @staticmethod
    def describe(values):
        return f"a spring pulls with {values['strength']:.1f} /s2 to (0.4, 0.5)"

    @staticmethod
    def acceleration(x, y, strength):
        return -strength * (x - 0.4), -strength * (y - 0.5)
'''
