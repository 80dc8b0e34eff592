"""Importing this registers bough's tasks with Gymnasium: ``gymnasium.make_vec("bough.envs:bough/reach-v0", 64)``."""

from .learn.gym.make import register

register()
