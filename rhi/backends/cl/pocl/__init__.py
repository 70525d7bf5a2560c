"""Code specific to PoCL: its cache of kernels, its header, its threads, and the memory of its programs.

What the OpenCL backend avoids, found with PoCL 3.1:

- `clEnqueueCopyBufferRect` crashes on sub-buffers. So a texture's levels are parts of one buffer.
- OpenCL refuses to copy a box within one buffer between two row lengths. Copies between levels of a texture
  use temporary memory.
- Releasing pyopencl's event of an unfinished write waits for it. Events are kept with their fence value.
- A kernel doesn't keep its arguments alive. The program keeps the arguments that were bound last.
- PoCL unrolls only loops with a pragma. Arrays that a loop's variable indexes go to memory otherwise.
- Reading a part of a vector that was just stored stalls.
- The compiler serves one thread of a process at a time, and launches wait while it generates machine code.
- `clGetProgramInfo` with `CL_PROGRAM_BINARIES` compiles every kernel once more.
- PoCL never frees what LLVM notes of a program: 4.9 KiB for a cached draw program, some 60 KiB for each
  compiled program (`heaptrack`, 200 programs).
- For each kernel PoCL copies a function once for every chain of calls that leads to it, so each further link
  doubles the work. Functions in the middle of long chains are inlined in quick kernels too.
- The compiler's output on standard error can't be turned off.
- The wheel of PoCL (3.0, LLVM 14) can't compile for newer CPUs (`unknown target CPU 'generic'`).
"""
