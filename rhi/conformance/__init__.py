"""The conformance kit, which every backend must pass: `pytest --pyargs rhi.conformance --rhi-backend NAME`.

- `operation/` tests the contract, one behaviour per test. Its shaders are written in the shading language, so
  one source serves every backend.
- `validation/` tests refused calls as far as they depend on the backend: limits and missing features
  (`test_capabilities`), and that a refused call leaves nothing behind (`test_refusals`). Each has a control:
  the nearest call that must pass. The front end's rules are the same on every backend;
  `tests/rhi/device/refusals` tests them once, on the null device.
- Expected values are computed here, in NumPy float64 or exact integers (`reference`), never copied from a
  device. Each tolerance is stated with its reason (`compare`).
- A test is skipped only for a capability that the device itself declares missing (`needs`).
- Targets are small and programs shared, so that the whole kit runs in a minute or two on a software GPU.
"""
