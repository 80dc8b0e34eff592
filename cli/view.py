"""``bough view``: what a folder or a file holds, on a page in the browser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import tyro

from ..sim.base.console import bar, first_ctrl_c_told, shown, start_warp
from ..sim.base.errors import InputError
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..learn.tasks.assembled import AssembledTask
    from ..sim.view.page import Page
    from ..sim.view.show import Scene

_KINDS = "a forest, a tree's MJCF or URDF file, a simulation, a case, a diagnosis, a posterior or a run of a policy"


@dataclass(frozen=True)
class View:
    """Show trees and their motion in the browser; what PATH holds is told by what is in it.

    A forest or a tree's file moves, with sliders and a pull by mouse; a simulation is played; a case is shown with what
    a model makes of it, before and after the repair of a diagnosis, or as a cloud of branches of a posterior; a policy
    acts. The page is served on this machine alone until Ctrl-C (a second one does not wait for a scene that is still
    being built); over SSH the second printed line forwards it. Needs pip install -e '.[view]' in bough's folder. Exit
    code 0: done; 2: bad input.

    Attributes:
        path: What to show.
        case: Case folder that a diagnosis or a posterior is of.
        port: Port to serve at; 0 takes any that is free.
        export: Write one HTML file that moves without a server and offline, instead of serving.
        law: A law that gets sliders in a forest, such as hysteresis_boucwen; once for each. Drag, dry friction and
            cubic springs if none is given.
        seed: Seed of the members that are drawn from a posterior, and of a policy's world.
        acts: In a policy's world: the policy, or zero (no action) or random (actions drawn uniformly).
        device: Warp device, such as cpu or cuda:0; Warp's first choice if not given.
    """

    path: tyro.conf.Positional[Path]
    case: Path | None = None
    port: int = 8080
    export: Path | None = None
    law: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    seed: int = 0
    acts: Literal["policy", "zero", "random"] = "policy"
    device: str | None = None

    def run(self) -> int:
        """Show until Ctrl-C, or write a page; return the exit code."""
        from ..sim.view.page import directions, open_page
        from ..sim.view.show import Loop, check_page, export

        build = scene_of(self)
        if self.export is not None:
            check_page(self.export)
        page = open_page(0 if self.export is not None else self.port)
        try:
            if self.export is not None:
                scene = build(page)
                with bar("recording", None):
                    size = export(page, scene, self.export)
                print(f"{scene.seconds:.1f} s of motion, {size / 2**20:.1f} MiB: {shown(self.export)}")
                return ExitCode.DONE
            with first_ctrl_c_told() as ended:  # the page's own threads wait for locks that the scene holds
                print(directions(page.port), flush=True)
                Loop(page, build(page)).run(ended)
        except KeyboardInterrupt:
            if self.export is not None:
                raise
        finally:
            page.stop()
        return ExitCode.DONE


Build = Callable[["Page"], "Scene"]


def scene_of(options: View) -> Build:
    """Return what puts the scene of a path on a page.

    Raises:
        InputError: There is nothing, or nothing that can be shown.
    """
    path = options.path
    if not path.exists():
        raise InputError(path, "", "no such file or folder", _KINDS)
    if not path.is_dir():
        return _file(options)
    names = {item.name for item in path.iterdir()}
    found = next((kind for name, kind in _FOLDERS.items() if name in names), None)
    if found is None:
        raise InputError(path, "", ", ".join(sorted(names)[:5]) or "an empty folder", _KINDS)
    return found(options)


def _file(options: View) -> Build:
    path = options.path
    if path.suffix == ".npz":
        return _posterior(options, path) if _is_posterior(path) else _recorded(path)
    return _living(options, forest=False)


def _is_posterior(path: Path) -> bool:
    from ..sim.base.archive import array_names

    return "particles" in array_names(path, "what bough simulate or bough identify writes")


def _recorded(file: Path) -> Build:
    from ..sim.view.recorded import Recorded

    return lambda page: Recorded(page, file)


def _case(options: View, folder: Path, diagnosis: Path | None = None) -> Build:
    from ..learn.view.replayed import branch_case

    case = branch_case(folder)
    start_warp()
    from ..learn.view.case import CaseScene
    from ..learn.view.replayed import before_and_after, nominal

    with bar("simulating the recordings", None):
        tellers = [nominal(case)] if diagnosis is None else before_and_after(case, diagnosis)
    return lambda page: CaseScene(page, case, tellers)


def _diagnosis(options: View) -> Build:
    return _case(options, _own_case(options), options.path)


def _posterior(options: View, file: Path) -> Build:
    from ..learn.view.replayed import branch_case, drawn_from, effects_beside

    case = branch_case(_own_case(options))
    start_warp()
    from ..learn.view.posterior import MEMBERS, PosteriorScene

    drawn = drawn_from(file, MEMBERS, options.seed, effects_beside(file))
    return lambda page: PosteriorScene(page, case, drawn, file)


def _policy(options: View) -> Build:
    from ..learn.policies.evaluate import random, read_policy, zero
    from ..learn.runs.folder import RunFolder
    from ..learn.tasks.registry import known_tasks
    from ..learn.tasks.task import require_rsl_rl, unseen_seed

    require_rsl_rl()
    start_warp()
    from ..learn.runs.processes import Processes
    from ..learn.view.policy import PolicyScene

    registry, folder = known_tasks(), RunFolder(options.path)
    trained = read_policy(folder, registry)
    device = Processes().device(options.device)
    with bar("preparing the world", None):
        task = registry.make(trained.name, trained.settings, num_envs=1, seed=unseen_seed(options.seed, 0),
                             device=device, test=True)  # fmt: skip
        acts = {"policy": trained.on, "zero": zero, "random": lambda t: random(t, options.seed)}
        policy = acts[options.acts](task)
    name = f"{trained.iteration} iterations" if options.acts == "policy" else f"{options.acts} actions"
    return lambda page: PolicyScene(page, cast("AssembledTask", task), policy, name)


def _own_case(options: View) -> Path:
    if options.case is None:
        raise InputError(options.path, "--case", "nothing", "the case folder that it is of")
    return options.case


def _living(options: View, *, forest: bool) -> Build:
    start_warp()
    from ..sim.engine.forest_effects import forest_terms
    from ..sim.view.forest import read_forest, read_tree
    from ..sim.view.living import Living
    from ..sim.view.sliders import LAWS

    forest_terms(tuple(dict.fromkeys(options.law)), "--law")
    planted = (read_forest if forest else read_tree)(options.path)

    def build(page: Page) -> Scene:
        """Start the planted trees on the page, with the laws that were asked for."""
        scene = Living(page, planted, laws=options.law or LAWS, device=options.device)
        scene.start()
        return scene

    return build


#: What a folder is, by a file that it holds, in the order in which they are looked for.
_FOLDERS: dict[str, Callable[[View], Build]] = {
    "forest.json": lambda o: _living(o, forest=True),
    "trajectory.npz": lambda o: _recorded(o.path / "trajectory.npz"),
    "meta.yaml": lambda o: _case(o, o.path),
    "verdict.json": _diagnosis,
    "config.json": _policy,
    "posterior.npz": lambda o: _posterior(o, o.path / "posterior.npz"),
}
