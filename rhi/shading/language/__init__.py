"""The shading language as users write it: types, structs, bindings, built-in functions, shader classes."""
