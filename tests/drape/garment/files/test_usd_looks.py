"""Materials of USD: colours, pictures in the archive and beside, alpha, places of pictures, subsets of faces."""

from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from drape.garment.files.mesh import GarmentMesh, read_mesh
from drape.garment.portrait import Sitter, portrait
from tests.drape.garment.files.test_looks import picture, zipped
from tests.drape.garment.test_portrait import corners, quarters

pytest.importorskip("pxr.Sdf", reason="No usd-core: `pip install usd-core`.")

RED = (200, 30, 20)
SQUARE = """
def Mesh "Shirt" (prepend apiSchemas = ["MaterialBindingAPI"])
{
  point3f[] points = [(-1, -1, 0), (0, -1, 0), (1, -1, 0), (-1, 1, 0), (0, 1, 0), (1, 1, 0)]
  int[] faceVertexCounts = [4, 4]
  int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4]
  texCoord2f[] primvars:other = [(9, 9), (9, 9), (9, 9), (9, 9), (9, 9), (9, 9)] (interpolation = "vertex")
  texCoord2f[] primvars:map = [(0, 0), (0.5, 0), (1, 0), (0, 1), (0.5, 1), (1, 1)] (interpolation = "vertex")
  rel material:binding = </Looks/Cloth>
  SUBSETS
}
"""
SUBSET = """
  uniform token subsetFamily:materialBind:familyType = "partition"
  def GeomSubset "right" (prepend apiSchemas = ["MaterialBindingAPI"])
  {
    uniform token elementType = "face"
    uniform token familyName = "materialBind"
    int[] indices = [1]
    rel material:binding = </Looks/Trim>
  }
"""
LOOKS = """
def Scope "Looks"
{
  def Material "Trim"
  {
    token outputs:surface.connect = </Looks/Trim/S.outputs:surface>
    def Shader "S"
    {
      uniform token info:id = "UsdPreviewSurface"
      color3f inputs:diffuseColor = (0.1, 0.5, 0.2)
      float inputs:roughness = 0.3
      float inputs:metallic = 0.7
      float inputs:opacity = 0.4
      token outputs:surface
    }
  }
  def Material "Cloth"
  {
    token outputs:surface.connect = </Looks/Cloth/S.outputs:surface>
    float inputs:rough = 0.6
    def Shader "S"
    {
      uniform token info:id = "UsdPreviewSurface"
      color3f inputs:diffuseColor.connect = </Looks/Cloth/T.outputs:rgb>
      normal3f inputs:normal.connect = </Looks/Cloth/N.outputs:rgb>
      float inputs:roughness.connect = ROUGH
      OPACITY
      token outputs:surface
    }
    def Shader "T"
    {
      uniform token info:id = "UsdUVTexture"
      asset inputs:file = @tex/colour.png@
      float2 inputs:st.connect = </Looks/Cloth/P.outputs:result>
      float3 outputs:rgb
      float outputs:a
    }
    def Shader "N"
    {
      uniform token info:id = "UsdUVTexture"
      asset inputs:file = @tex/bumps.png@
      float3 outputs:rgb
    }
    def Shader "R"
    {
      uniform token info:id = "UsdUVTexture"
      asset inputs:file = @tex/rough.png@
      float outputs:r
      float outputs:g
    }
    def Shader "P"
    {
      uniform token info:id = "UsdTransform2d"
      float2 inputs:in.connect = </Looks/Cloth/V.outputs:result>
      float inputs:rotation = ANGLE
      float2 inputs:scale = (1, 1)
      float2 inputs:translation = PLACE
      float2 outputs:result
    }
    def Shader "V"
    {
      uniform token info:id = "UsdPrimvarReader_float2"
      token inputs:varname = "map"
      float2 outputs:result
    }
  }
}
"""
PICTURES = {
    "tex/colour.png": quarters(),
    "tex/bumps.png": picture((128, 128, 255)),
    "tex/rough.png": picture((90, 150, 10)),
}


def usda(
    *, rough: str = "</Looks/Cloth.inputs:rough>", opacity: str = "", angle: str = "0", place: str = "(0, 0)"
) -> str:
    looks = LOOKS.replace("ROUGH", rough).replace("OPACITY", opacity).replace("ANGLE", angle).replace("PLACE", place)
    return '#usda 1.0\n(metersPerUnit = 1\n upAxis = "Y")\n' + SQUARE.replace("SUBSETS", SUBSET) + looks


def read(text: str) -> GarmentMesh:
    return read_mesh(zipped({"a/shirt.usda": text} | {f"a/{name}": one for name, one in PICTURES.items()}), kind="zip")


def cloth_of(mesh: GarmentMesh):
    look = mesh.looks.material(mesh.material_names.index("Cloth"))
    assert look is not None
    return look


def test_each_face_has_the_colours_and_numbers_of_its_material():
    mesh = read(usda())
    assert [mesh.material_names[number] for number in mesh.face_material] == ["Cloth", "Cloth", "Trim", "Trim"]
    trim, cloth = mesh.looks.material(mesh.material_names.index("Trim")), cloth_of(mesh)
    assert trim is not None
    assert_allclose(trim.base_colour, (0.1, 0.5, 0.2, 0.4), atol=1e-6)
    assert_allclose((trim.roughness, trim.metallic), (0.3, 0.7), atol=1e-6)
    assert (trim.alpha_mode, trim.pictures) == ("BLEND", {})
    assert set(cloth.pictures) == {"base_colour", "normal"} and cloth.alpha_mode == "OPAQUE"
    assert_allclose((cloth.roughness, cloth.metallic), (0.6, 0.0), atol=1e-6)
    assert len(mesh.looks.pictures) == 2 and not any("warning" in note for note in mesh.notes)
    assert_allclose(mesh.uv.max(axis=0), 1.0, err_msg="the coordinates that its reader names")


def test_what_is_no_number_counts_as_not_there():
    broken = usda().replace("float inputs:metallic = 0.7", 'string inputs:metallic = "much"')
    mesh = read(broken.replace("float inputs:opacity = 0.4", "float2 inputs:opacity = (0.4, 0.2)"))
    trim = mesh.looks.material(mesh.material_names.index("Trim"))
    assert trim is not None
    assert (trim.metallic, trim.base_colour[3], trim.alpha_mode) == (0.0, 1.0, "OPAQUE")


def test_roughness_in_a_channel_becomes_the_picture_of_gltf():
    for channel, grey in (("r", 90), ("g", 150)):
        mesh = read(usda(rough=f"</Looks/Cloth/R.outputs:{channel}>"))
        look = cloth_of(mesh)
        assert (look.roughness, look.metallic) == (1.0, 0.0)
        made = np.asarray(Image.open(io.BytesIO(mesh.looks.pictures[look.pictures["metallic_roughness"]])))
        assert made[0, 0, 1] == grey


def test_alpha_is_cut_out_or_seen_through():
    alpha = "float inputs:opacity.connect = </Looks/Cloth/T.outputs:a>\n"
    assert cloth_of(read(usda(opacity=alpha))).alpha_mode == "BLEND"
    cut = cloth_of(read(usda(opacity=alpha + "float inputs:opacityThreshold = 0.3")))
    assert cut.alpha_mode == "MASK" and abs(cut.alpha_cutoff - 0.3) < 1e-6


@pytest.mark.parametrize(
    ("angle", "place", "shown"),
    [
        ("0", "(0, 0)", ["r", "g", "b", ""]),
        ("0", "(0.5, 0)", ["g", "r", "", "b"]),
        ("180", "(1, 1)", ["", "b", "g", "r"]),
        ("90", "(1, 0)", ["b", "r", "", "g"]),  # (u, v) shows what lies at (1 - v, u)
    ],
)
def test_a_picture_is_placed_as_its_transform_says(angle: str, place: str, shown: list[str]):
    mesh = read(
        usda(angle=angle, place=place).replace(
            "rel material:binding = </Looks/Trim>", "rel material:binding = </Looks/Cloth>"
        )
    )
    sitter = Sitter(mesh.vertices, mesh.faces, mesh.uv, mesh.uv_faces, mesh.face_material, mesh.looks)
    assert corners(portrait(sitter, None, 40)) == shown


def test_an_archive_holds_its_pictures_and_a_missing_one_is_told():
    inside = zipped({"shirt.usda": usda()} | PICTURES, 0)
    assert set(cloth_of(read_mesh(inside, kind="usdz")).pictures) == {"base_colour", "normal"}
    bare = read_mesh(usda().encode(), kind="usda")
    assert cloth_of(bare).pictures == {} and sum("is not beside the mesh" in note for note in bare.notes) == 2
    outside = usda().replace("tex/colour.png", "/etc/hostname")
    assert set(cloth_of(read_mesh(outside.encode(), kind="usda")).pictures) == set(), "nothing of this machine"
