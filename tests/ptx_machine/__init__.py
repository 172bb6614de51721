"""A machine for PTX: executes on this processor what NVRTC makes of the CUDA kernels, and watches every access.

It sees what the compiler emitted, with its fused operations, where tests/cuda_shim sees the source. NVRTC compiles a
.cu file to PTX (nvrtc.py), which is read (ptx.py) and becomes C++ (translator.py): a function for each kernel, which
returns wherever threads meet. machine/ holds the rest: instructions by PTX's names, the operations of warps, the order
in which threads run, and the watch. launcher.py has the interface of a GPU's launcher.

Not modelled: the driver's assembler, the order in which a GPU's memory shows what was written, time.
"""
