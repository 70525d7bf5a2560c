"""The end of every technique, once its opaque surfaces are drawn: sky, transparent surfaces, glow and tones."""

from __future__ import annotations

from renderer.frame import Blending, Effect, Frame, Needs, Pass, find_last
from renderer.frame.tones import find_light
from renderer.shaders.fog import through_all_fog
from renderer.shaders.pixels import BackgroundScreen, place_pixel
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.glow import glow_passes
from renderer.techniques.parts.scene_shader import FinishShader
from renderer.techniques.parts.transparency import declare_transparency, sorted_pass
from renderer.techniques.parts.variants import FORWARD, Lighting, draw_full_screen, lit_pass, name_samples
from rhi import DepthFunction
from rhi.shading import Struct, Uniform, fragment_coordinate, vec3, vec4


class Background(Struct):
    """The light of what is behind everything."""

    light: vec3


class SkyShader(BackgroundScreen, FinishShader):
    """Draws the background as it is seen through all of the fog."""

    background: Uniform[Background]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        direction = place_pixel(self.rays, place, 1.0) - place_pixel(self.rays, place, 0.0)
        return self.finish(through_all_fog(self.background.light, direction, self.fog), direction)


def forward_passes(needs: Needs, lighting: Lighting = FORWARD, *, samples: int = 1) -> tuple[Pass[Frame], ...]:
    """Return the passes of forward shading: one over the visible objects, lit by the lists of their lights, and those
    of `finish_image`. Techniques without lamps in view are drawn by them."""
    return draw_once(needs, lighting, "draws the visible objects, lit", samples=samples)


def draw_once(
    needs: Needs, lighting: Lighting, because: str,
    *, samples: int, depth_first: str = "", lists: tuple[Pass[Frame], ...] = (), transparent: Lighting = FORWARD,
) -> tuple[Pass[Frame], ...]:  # fmt: skip
    """Return the passes of a technique that draws the visible objects lit, once: `depth`, if it is drawn before, those
    that list lights, `forward`, and those of `finish_image`.

    Depth of several samples can't be read, but layers, culling and lists of lights read depth. So with several samples,
    depth of one is always drawn before, and if `depth_first`, then that of all.

    Args:
        lighting, because: as for `lit_pass`.
        samples: samples per pixel.
        depth_first: why depth is drawn before; empty if it isn't.
        lists: the passes that list lights.
        transparent: how transparent surfaces are lit.
    """
    passes = list(lists)
    if depth_first or samples > 1:
        passes.insert(0, depth_pass(depth_first or "layers and culling can't read depth of several samples"))
    if depth_first and samples > 1:
        passes.append(depth_pass("no hidden fragment is lit", samples=samples))
    passes.append(lit_pass(needs, lighting, because, after_depth=bool(depth_first), samples=samples))
    return *passes, *finish_image(needs, transparent, samples=samples)


def finish_image(
    needs: Needs, lighting: Lighting, *, samples: int = 1, has_sky: bool = False
) -> tuple[Pass[Frame], ...]:
    """Return the passes that make `image` of the contents `needs.image`, in which opaque surfaces have been drawn.

    Args:
        lighting: how transparent surfaces are lit.
        samples: how many samples a pixel has. With more than one, surfaces are in contents that `name_samples` names.
        has_sky: whether fog before the background has been drawn, too.
    """
    image = needs.image.name
    if samples == 1:
        passes = [] if has_sky else [*_sky_passes(needs, image, "depth")]
        passes += declare_transparency(needs, lighting, image=find_last(passes, image))
    else:
        drawn, depth = name_samples(image, samples), name_samples("depth", samples)
        passes = [*_sky_passes(needs, drawn, depth)]
        # Weighted sums can't be resolved: those surfaces are drawn after it, with one sample.
        is_sorted = needs.blending is Blending.SORTED
        if is_sorted and Effect.TRANSPARENCY in needs.effects:
            passes.append(sorted_pass(needs, lighting, image=find_last(passes, drawn), depth=depth))
        passes.append(_resolve_pass(needs, find_last(passes, drawn)))
        passes += () if is_sorted else declare_transparency(needs, lighting, image=image)
    return *passes, *glow_passes(needs, find_last(passes, image))


def _resolve_pass(needs: Needs, samples: str) -> Pass[Frame]:
    def resolve(frame: Frame) -> None:
        frame.targets[samples].resolve_to(frame.image)

    return Pass("resolve", resolve, "a pixel is the mean of its samples", reads=(samples,), writes=(needs.image,))


def _sky_passes(needs: Needs, image: str, depth: str) -> tuple[Pass[Frame], ...]:
    """Return the pass that draws the fog before the background over the contents `image`: none without fog."""
    if Effect.FOG not in needs.effects:
        return ()

    def draw(frame: Frame) -> None:
        background = Background(light=find_light(frame.resources.scene.background))
        draw_full_screen(
            frame,
            SkyShader,
            frame.targets[image],
            {"background": frame.resources.mirror(background)},
            depth=frame.targets[depth],
            states=(DepthFunction.EQUAL,),  # to the farthest depth, at which the triangle is
            switches={"has_fog": False, "has_haze": False},
        )

    because = f"shows fog before the background; {needs.explain(Effect.FOG)}"
    return (Pass("sky", draw, because, reads=(depth,), changes={image: f"{image} with sky"}),)
