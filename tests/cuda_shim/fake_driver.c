/* A libcuda.so.1 that prints what it is asked for, so that the launch helper can be tested without a card. A kernel whose
   name is "refused" does not launch, nor does any in a thread where the first card's context is not current. Memory is short
   for launching "large" and for loading "huge"; launching "lost" fails as after an illegal address. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { kOk = 0, kInvalidValue = 1, kOutOfMemory = 2, kInvalidContext = 201, kIllegalAddress = 700, kNotSupported = 801 };
enum { kMapsMemory = 102 };  /* an attribute of devices: virtual memory management */
enum { kLibrary = 0x77, kContext = 0xC0, kRefusedKernel = 0x666, kLargeKernel = 0x999, kLostKernel = 0xBAD, kKernel = 0x1234 };

static _Thread_local void* current = NULL;  /* context of the calling thread */

int cuLaunchKernel(void* kernel, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz, unsigned shared,
                  void* stream, void** params, void** extra) {
  if (current != (void*)(uintptr_t)kContext) return kInvalidContext;
  if ((uintptr_t)kernel == kRefusedKernel) return kInvalidValue;
  if ((uintptr_t)kernel == kLargeKernel) return kOutOfMemory;
  if ((uintptr_t)kernel == kLostKernel) return kIllegalAddress;
  printf("launch %p blocks %u %u %u threads %u %u %u shared %u stream %p first parameter %lld extra %d\n", kernel, gx, gy, gz, bx,
         by, bz, shared, stream, *(long long*)params[0], extra != NULL);
  return kOk;
}

static int init(unsigned flags) { return flags == 0 ? kOk : kInvalidValue; }

static int version(int* number) {
  *number = 13000;
  return kOk;
}

static int error_name(int error, const char** text) {
  *text = error == kInvalidValue  ? "CUDA_ERROR_INVALID_VALUE"
          : error == kOutOfMemory ? "CUDA_ERROR_OUT_OF_MEMORY"
          : error == kIllegalAddress ? "CUDA_ERROR_ILLEGAL_ADDRESS"
                                  : "CUDA_ERROR_UNKNOWN";
  return kOk;
}

static int error_string(int error, const char** text) {
  *text = error == kInvalidValue ? "invalid argument" : error == kOutOfMemory ? "out of memory" : "unknown error";
  return kOk;
}

static int load(void** library, const char* code, void* a, void* b, unsigned n, void* c, void* d, unsigned m) {
  (void)a, (void)b, (void)n, (void)c, (void)d, (void)m;
  printf("load %.3s\n", code + 1);
  *library = (void*)(uintptr_t)kLibrary;
  return kOk;
}

static int get_kernel(void** kernel, void* library, const char* name) {
  if ((uintptr_t)library != kLibrary) return kInvalidValue;
  if (strcmp(name, "huge") == 0) return kOutOfMemory;
  *kernel = (void*)(uintptr_t)(strcmp(name, "refused") == 0 ? kRefusedKernel
                               : strcmp(name, "large") == 0 ? kLargeKernel
                               : strcmp(name, "lost") == 0 ? kLostKernel
                                                            : kKernel);
  return kOk;
}

static int unload(void* library) { return (uintptr_t)library == kLibrary ? kOk : kInvalidValue; }

static int get_device(int* device, int ordinal) {
  *device = ordinal;
  return kOk;
}

static int get_attribute(int* value, int attribute, int device) {
  (void)device;
  *value = attribute == kMapsMemory;
  return kOk;
}

static int retain(void** context, int device) {
  *context = (void*)(uintptr_t)(kContext + device);
  return kOk;
}

static int set_current(void* context) {
  current = context;
  return kOk;
}

static int not_supported(void) { return kNotSupported; }

int cuGetProcAddress_v2(const char* name, void** function, int driver, uint64_t flags, int* status) {
  static const struct {
    const char* name;
    void* function;
  } known[] = {
      {"cuInit", (void*)init},
      {"cuDriverGetVersion", (void*)version},
      {"cuGetErrorName", (void*)error_name},
      {"cuGetErrorString", (void*)error_string},
      {"cuDeviceGet", (void*)get_device},
      {"cuDeviceGetAttribute", (void*)get_attribute},
      {"cuDevicePrimaryCtxRetain", (void*)retain},
      {"cuCtxSetCurrent", (void*)set_current},
      {"cuLibraryLoadData", (void*)load},
      {"cuLibraryGetKernel", (void*)get_kernel},
      {"cuLibraryUnload", (void*)unload},
      {"cuGetProcAddress", (void*)cuGetProcAddress_v2},
  };
  (void)driver, (void)flags;
  *function = (void*)not_supported;
  for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); ++i)
    if (strcmp(name, known[i].name) == 0) *function = known[i].function;
  if (status) *status = 0;
  return kOk;
}

int cuGetProcAddress(const char* name, void** function, int driver, uint64_t flags) {
  return cuGetProcAddress_v2(name, function, driver, flags, NULL);
}

int cuDriverGetVersion(int* number) { return version(number); }
