"""Writes one small tube in every variant that other tools write, for tests/formats.rs.

    pip install vtk==9.7.2 meshio==5.3.5 trimesh numpy && python make.py

The tube is made here: 4 rings of 8 vertices, quads between them, an octagon at each end.
Coordinates are multiples of 1/8, so that no writer rounds them.
"""
import math
import os

import meshio
import numpy
import trimesh
import vtk

os.chdir(os.path.dirname(os.path.abspath(__file__)))

points = [
    tuple(round(8 * c) / 8 for c in (r * math.cos(a) + 0.3 * k * k, r * math.sin(a) - 5, 2.0 * k))
    for k, r in enumerate((1.0, 1.25, 1.5, 1.0))
    for a in (i * math.pi / 4 for i in range(8))
]
faces = [[8 * k + i, 8 * k + (i + 1) % 8, 8 * k + 8 + (i + 1) % 8, 8 * k + 8 + i] for k in range(3) for i in range(8)]
faces += [list(range(7, -1, -1)), list(range(24, 32))]
triangles = [[f[0], f[i], f[i + 1]] for f in faces for i in range(1, len(f) - 1)]


def polydata(cells, lines=(), strips=()):
    data = vtk.vtkPolyData()
    vtk_points = vtk.vtkPoints()
    for point in points:
        vtk_points.InsertNextPoint(point)
    data.SetPoints(vtk_points)
    for kind, setter in ((cells, data.SetPolys), (lines, data.SetLines), (strips, data.SetStrips)):
        array = vtk.vtkCellArray()
        for cell in kind:
            array.InsertNextCell(len(cell), cell)
        if kind:
            setter(array)
    ids = vtk.vtkIntArray()
    ids.SetName("ids")
    for i in range(len(points)):
        ids.InsertNextValue(i * 37 % 11)
    data.GetPointData().SetScalars(ids)
    time = vtk.vtkDoubleArray()
    time.SetName("TimeValue")
    time.InsertNextValue(0.5)
    data.GetFieldData().AddArray(time)
    return data


def write(writer, name, data):
    writer.SetFileName(name)
    writer.SetInputData(data)
    assert writer.Write() == 1, name


polygons = polydata(faces, lines=[[0, 8, 16]])
for mode in ("Ascii", "Binary", "Appended"):
    for compressor in ("None", "ZLib", "LZ4"):
        for order in ("LittleEndian", "BigEndian"):
            for header in ("UInt32", "UInt64"):
                for encode in (True, False) if mode == "Appended" else (True,):
                    if (mode == "Ascii" or compressor == "LZ4") and (order, header, encode) != ("LittleEndian", "UInt64", True):
                        continue
                    writer = vtk.vtkXMLPolyDataWriter()
                    getattr(writer, f"SetDataModeTo{mode}")()
                    getattr(writer, f"SetCompressorTypeTo{compressor}")()
                    getattr(writer, f"SetByteOrderTo{order}")()
                    getattr(writer, f"SetHeaderTypeTo{header}")()
                    writer.SetEncodeAppendedData(encode)
                    if hasattr(writer, "SetBlockSize"):
                        writer.SetBlockSize(64)
                    kind = mode.lower() + ("" if mode != "Appended" else "-base64" if encode else "-raw")
                    write(writer, f"{kind}-{compressor.lower()}-{order[0].lower()}{header[-2:]}.vtp", polygons)

strips = [[8 * k + o + 8 * s for i in range(9) for o, s in (((i % 8), 1), ((i % 8), 0))] for k in range(3)]
caps = [[f[0], f[i], f[i + 1]] for f in faces[-2:] for i in range(1, 7)]
write(vtk.vtkXMLPolyDataWriter(), "strips.vtp", polydata(caps, strips=strips))
write(vtk.vtkXMLPolyDataWriter(), "lines.vtp", polydata([], lines=[[0, 8, 16]]))
for version in (42, 51):
    for binary in (False, True):
        writer = vtk.vtkPolyDataWriter()
        writer.SetFileVersion(version)
        writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
        kind = "binary" if binary else "ascii"
        write(writer, f"{kind}-{version}.vtk", polygons)
        write(writer, f"strips-{kind}-{version}.vtk", polydata(caps, lines=[[0, 8, 16]], strips=strips))

for kind in ("ASCII", "Binary"):
    for extension, writer in (("stl", vtk.vtkSTLWriter()), ("ply", vtk.vtkPLYWriter())):
        getattr(writer, f"SetFileTypeTo{kind}")()
        data = polydata(triangles) if extension == "stl" else polygons
        write(writer, f"vtk-{kind.lower()}.{extension}", data)
big = vtk.vtkPLYWriter()
big.SetDataByteOrderToBigEndian()
write(big, "vtk-big.ply", polygons)
write(vtk.vtkOBJWriter(), "vtk.obj", polygons)

only_triangles = meshio.Mesh(numpy.array(points), [("triangle", triangles)])
for name, options in (("ascii", {"binary": False}), ("binary", {"binary": True})):
    for extension in ("stl", "ply"):
        meshio.write(f"meshio-{name}.{extension}", only_triangles, **options)
meshio.write("meshio-grid.vtk", only_triangles)
meshio.write("meshio.off", only_triangles)
meshio.write("meshio.obj", only_triangles)

scene = trimesh.Trimesh(points, triangles, process=False)
for extension in ("off", "ply", "stl", "obj", "glb"):
    scene.export(f"trimesh.{extension}")
scene.export("trimesh-ascii.stl", file_type="stl_ascii")
embedded = trimesh.exchange.gltf.export_gltf(trimesh.Scene(scene), embed_buffers=True)
with open("trimesh.gltf", "wb") as out:
    out.write(embedded["model.gltf"])
