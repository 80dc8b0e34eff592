"""Names of bough's tasks, apart from all that they are made of: a command line asks for them and imports no more."""

CLEARING = ("powerline", "exposure", "inspection")
"""Tasks of chapter 5: clear branches from a target."""

REACHING = ("reach",)
"""Tasks of chapter 4: reach a target through branches."""
