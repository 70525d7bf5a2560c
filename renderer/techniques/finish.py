"""What every technique ends with, once its opaque surfaces are drawn: sky, transparent surfaces, glow and tones."""

from __future__ import annotations

from renderer.frame import Blending, Effect, Frame, Needs, Pass, find_last
from renderer.techniques.air import sky_passes
from renderer.techniques.glow import glow_passes
from renderer.techniques.transparency import Lighting, declare_transparency, sorted_pass

__rhi_internal__ = True


def finish_image(
    needs: Needs, lighting: Lighting, *, reads: tuple[str, ...] = (), samples: int = 1
) -> tuple[Pass[Frame], ...]:
    """Return the passes that make `image` of the contents `needs.image`, in which opaque surfaces have been drawn.

    Args:
        lighting: finds the shader of transparent surfaces. reads: contents that it reads.
        samples: how many samples a pixel has. With more than one, surfaces are in contents that `name_samples` names.
    """
    image = needs.image.name
    if samples == 1:
        passes = [*sky_passes(needs, image, "depth")]
        passes += declare_transparency(needs, lighting, reads=reads, image=find_last(passes, image))
    else:
        drawn, depth = name_samples(image), name_samples("depth")
        passes = [*sky_passes(needs, drawn, depth)]
        # Weighted sums can't be resolved: those surfaces are drawn after it, with one sample.
        is_sorted = needs.blending is Blending.SORTED
        if is_sorted and Effect.TRANSPARENCY in needs.effects:
            passes.append(sorted_pass(needs, lighting, image=find_last(passes, drawn), depth=depth))
        passes.append(_resolve_pass(needs, find_last(passes, drawn)))
        passes += () if is_sorted else declare_transparency(needs, lighting, image=image)
    return *passes, *glow_passes(needs, find_last(passes, image))


def name_samples(contents: str) -> str:
    """Return the name of contents with several samples per pixel."""
    return f"{contents} samples"


def _resolve_pass(needs: Needs, samples: str) -> Pass[Frame]:
    def resolve(frame: Frame) -> None:
        frame.targets[samples].resolve_to(frame.image)

    return Pass("resolve", resolve, "a pixel is the mean of its samples", reads=(samples,), writes=(needs.image,))
