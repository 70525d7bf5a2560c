"""The parts that every implementation of WebGPU shares: the contract's methods on WebGPU's objects.

`wgpu` brings the native implementation (wgpu-native), `web` a page's own. Each gives `WebGpuBackend` an
`Implementation`: the hot functions, the fence, the mapped reads, and how errors are raised.
"""
