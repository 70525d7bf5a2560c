"""The exam that any backend takes: `pytest --pyargs rhi.conformance --rhi-backend NAME`.

- `operation/` holds one behaviour of the contract a test; its shaders are written in the shading language,
  so one source serves every backend. `validation/` holds each rule a user can break, with a control: the
  nearest call that must pass.
- Expected values are computed here, in NumPy float64 or exact integers (`reference`), never copied from a
  device. A tolerance is stated with its reason (`compare`).
- A test is skipped only for a capability that the device itself declares missing (`needs`).
- Targets are small and programs shared, so that the whole kit runs in a minute or two on a software GPU.
"""
