// Stacks that one processor switches between. On x86-64 by hand, since ucontext asks the kernel at every switch.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#if defined(__x86_64__)

struct Fiber {
  void* stack_pointer = nullptr;
};

extern "C" void shim_switch(void** save, void* load);
asm(R"(
  .pushsection .text
  .weak shim_switch
  shim_switch:
    pushq %rbp
    pushq %rbx
    pushq %r12
    pushq %r13
    pushq %r14
    pushq %r15
    movq %rsp, (%rdi)
    movq %rsi, %rsp
    popq %r15
    popq %r14
    popq %r13
    popq %r12
    popq %rbx
    popq %rbp
    ret
  .popsection
)");

inline void switch_fiber(Fiber& from, Fiber& to) { shim_switch(&from.stack_pointer, to.stack_pointer); }

// Begins at `main`, which must never return, at the first switch to it.
inline void start_fiber(Fiber& fiber, uint64_t* stack, size_t words, void (*main)()) {
  uint64_t* top = stack + words - 2;  // main expects the stack as after a call: 8 bytes past a multiple of 16
  top -= (uint64_t(top) / 8) % 2 == 0 ? 0 : 1;
  *--top = 0;
  *--top = uint64_t(main);
  for (int i = 0; i < 6; ++i) *--top = 0;
  fiber.stack_pointer = top;
}

#else

#include <ucontext.h>

struct Fiber {
  ucontext_t context;
};

inline void switch_fiber(Fiber& from, Fiber& to) { swapcontext(&from.context, &to.context); }

inline void start_fiber(Fiber& fiber, uint64_t* stack, size_t words, void (*main)()) {
  getcontext(&fiber.context);
  fiber.context.uc_stack.ss_sp = stack;
  fiber.context.uc_stack.ss_size = words * sizeof(uint64_t);
  fiber.context.uc_link = nullptr;
  makecontext(&fiber.context, main, 0);
}

#endif
