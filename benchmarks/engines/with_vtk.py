"""The city with VTK, one sample a pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import vtk
from serving import Job, encode, serve
from vtk.util.numpy_support import vtk_to_numpy


def load(job: Job) -> tuple[str, Callable[[], Any]]:
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(job["width"], job["height"])
    window.SetMultiSamples(0)
    window.AddRenderer(vtk.vtkRenderer())
    importer = vtk.vtkGLTFImporter()
    importer.SetFileName(job["path"])
    importer.SetRenderWindow(window)
    importer.Update()
    renderer = window.GetRenderers().GetFirstRenderer()
    renderer.SetBackground(*encode(job["background"]))
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*job["eye"])
    camera.SetFocalPoint(
        *(coordinate + step for coordinate, step in zip(job["eye"], job["ahead"], strict=True))
    )
    camera.SetViewUp(0.0, 1.0, 0.0)
    camera.SetViewAngle(job["fov"])
    pixels = vtk.vtkUnsignedCharArray()

    def draw() -> Any:
        camera.SetClippingRange(job["near"], job["far"])
        window.Render()
        window.GetPixelData(0, 0, job["width"] - 1, job["height"] - 1, 1, pixels, 0)
        return vtk_to_numpy(pixels).reshape(job["height"], job["width"], 3)[::-1]

    lines = [line for line in window.ReportCapabilities().splitlines() if "renderer string" in line]
    return lines[0].partition(":")[2].strip() if lines else window.GetClassName(), draw


if __name__ == "__main__":
    serve(load)
