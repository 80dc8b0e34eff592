"""Play, pause, scrub and speed of a recorded motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .page import Page

SPEEDS = {"¼ ×": 0.25, "½ ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "4 ×": 4.0}
"""Speeds of playing, by what the control says."""


class Player:
    """The clock of a recorded motion, with its controls.

    Attributes:
        seconds: Length of the motion [s].
        time: Where it is now [s].
        playing: Whether it moves.
    """

    def __init__(self, page: Page, seconds: float) -> None:
        gui = page.server.gui
        self.seconds, self.time, self.playing = max(seconds, 1e-6), 0.0, True
        self._button = gui.add_button("Pause")
        self._slider = gui.add_slider("time [s]", 0.0, self.seconds, self.seconds / 1000.0, 0.0)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×")
        self._button.on_click(lambda _event: self.play(not self.playing))
        self._slider.on_update(self._scrubbed)

    def play(self, playing: bool) -> None:
        """Play or pause; from the start again where it had come to the end."""
        if playing and self.time >= self.seconds:
            self.time = 0.0
        self.playing, self._button.label = playing, "Pause" if playing else "Play"

    def _scrubbed(self, event: Any) -> None:
        if event.client is not None:  # a person, not `tick`
            self.play(False)
            self.time = float(self._slider.value)

    def tick(self, seconds: float) -> float:
        """Let real time [s] go by; return where the motion is [s]. It begins anew after its end."""
        if self.playing:
            self.time += seconds * SPEEDS[self._speed.value]
            if self.time > self.seconds:
                self.time = 0.0
            self._slider.value = round(self.time, 2)  # what the box beside the slider has room for
        return self.time
