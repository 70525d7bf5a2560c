"""Particles with materials: copies of a mesh, moved by an emitter, with any material of the scene.

- `emitter`: an emitter as data, and the simulation of any number of them, which a `SceneBuilder` takes.
- `mesh_particles`: the base of such simulations, for emitters of your own.
- `particle_kernels`: the vertices of all copies, in one dispatch.

An emitter is an object whose mesh has all copies. So its particles are drawn by the scene's own shaders: lit, textured,
masked or transparent, in every technique, in shadow maps and in fog.
"""

from renderer.scene.particles.emitter import Emitter, EmitterSimulation
from renderer.scene.particles.mesh_particles import MeshParticles, ParticlePoses, make_quad

__all__ = ["Emitter", "EmitterSimulation", "MeshParticles", "ParticlePoses", "make_quad"]
