"""``bough forest`` from the outside."""

import json

import mujoco
import numpy as np
import PIL.Image
import trimesh

LSYSTEM = """
axiom: "!(1)F(10)A"
productions: ["A -> [&(a)!(0.7)F(8)A]/(120)[&(a)!(0.7)F(8)A]"]
constants: {a: 30}
iterations: 2
scale_m_per_unit: 0.05
width_m_per_unit: 0.03
"""


def test_forest_writes_every_file_it_lists(forest):
    """Write tree_0000.xml, .urdf, .glb ..., forest.json and forest.png, and nothing else."""
    listed = json.loads((forest / "forest.json").read_text())
    names = {name for tree in listed["trees"] for name in tree["files"]}
    assert names == {f"tree_000{i}{s}" for i in range(3) for s in (".xml", ".urdf", ".glb")}
    assert {p.name for p in forest.iterdir()} == names | {"forest.json", "forest.png"}
    assert listed["options"]["seed"] == 5 and listed["options"]["species"] == "Ta"


def test_forest_files_are_what_the_list_says(forest):
    """Agree with C MuJoCo on dofs and mass of MJCF and URDF, and with trimesh on the height of the GLB."""
    trees = json.loads((forest / "forest.json").read_text())["trees"]
    assert len({t["mass_kg"] for t in trees}) == 3
    for tree in trees:
        mjcf, urdf, glb = (forest / name for name in tree["files"])
        model = mujoco.MjModel.from_xml_path(str(mjcf))
        assert (model.nbody - 1, model.nv) == (tree["links"], tree["dofs"]) == (17, 51)
        np.testing.assert_allclose(model.body_mass.sum(), tree["mass_kg"], atol=1e-6)
        other = mujoco.MjModel.from_xml_path(str(urdf))
        assert other.nv == tree["dofs"]
        np.testing.assert_allclose(other.body_mass.sum(), tree["mass_kg"], atol=1e-6)
        # glTF has y up; rounded ends reach past the capsules' axes by at most a radius (17 mm on the trunk).
        height = np.ptp(trimesh.load(glb).bounds[:, 1])
        assert tree["height_m"] < height < tree["height_m"] + 0.04


def test_forest_picture_shows_sky_wood_and_grass(forest):
    """Draw a picture of the size asked for, bluish above and greenish below."""
    image = np.asarray(PIL.Image.open(forest / "forest.png"), dtype=float)
    assert image.shape == (180, 320, 3)
    sky, grass = image[:20].mean(axis=(0, 1)), image[-20:].mean(axis=(0, 1))
    assert sky[2] > sky[0] and grass[1] > grass[2]


def test_forest_draws_leaves_on_demand(bough, forest):
    """Draw another, greener picture with --leaves, of the same trees."""
    assert bough("forest", "--count", 3, "--seed", 5, "--picture-width", 320, "--leaves", "--out", "leafy").code == 0
    bare, leafy = (np.asarray(PIL.Image.open(p), dtype=float) for p in (forest / "forest.png", "leafy/forest.png"))
    assert (leafy[..., 1] - leafy[..., 2])[:120].mean() > (bare[..., 1] - bare[..., 2])[:120].mean()
    with open("leafy/tree_0000.xml") as same:
        assert same.read() == (forest / "tree_0000.xml").read_text()


def test_forest_depends_on_seed_and_number_alone(bough, forest):
    """Grow the same first trees, to the byte, whatever the count; other ones from another seed."""
    again = bough("forest", "--count", 1, "--seed", 5, "--picture-width", 0, "--out", "again")
    other = bough("forest", "--count", 1, "--seed", 6, "--picture-width", 0, "--out", "other")
    assert again.code == other.code == 0
    text = (forest / "tree_0000.xml").read_text()
    with open("again/tree_0000.xml") as same, open("other/tree_0000.xml") as different:
        assert same.read() == text
        assert different.read() != text


def test_forest_of_an_lsystem_file(bough, tmp_path):
    """Grow an L-system from a file: 1 + 2 + 4 segments, beams' springs, the file's own number of iterations."""
    (tmp_path / "bush.yaml").write_text(LSYSTEM)
    done = bough("forest", "--lsystem", "bush.yaml", "--count", 2, "--noise", 0, "--stiffness", "beam",
                 "--picture-width", 0, "--out", "out")  # fmt: skip
    assert done.code == 0, done.err
    assert done.out == "2 trees of 7 links, 1.20 m tall: out/tree_*.xml, forest.json\n"
    model = mujoco.MjModel.from_xml_path("out/tree_0000.xml")
    # K = E pi r^4 / (2 l) of the first segment: 30 mm thick, 0.5 m long, E = 3 GPa
    np.testing.assert_allclose(model.jnt_stiffness[0], 3e9 * np.pi * 0.015**4 / (2 * 0.5), rtol=1e-9)


def test_forest_keeps_what_else_lies_in_its_folder(bough, tmp_path):
    """Replace files of the same name in an existing folder and leave the others."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out/notes.txt").write_text("mine")
    (tmp_path / "out/tree_0000.xml").write_text("old")
    assert bough("forest", "--count", 1, "--picture-width", 0, "--out", "out").code == 0
    assert (tmp_path / "out/notes.txt").read_text() == "mine"
    assert (tmp_path / "out/tree_0000.xml").read_text() != "old"
