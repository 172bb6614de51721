// A vector type of 4, 8 or 16 floats, depending on the variant, written with the compiler's vector extensions.
// Files that include this header are compiled once for each variant, with MGSR_ISA as the namespace of their code.
#pragma once

#include <cstdint>
#include <cstring>
#include <utility>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace mgsr {
namespace MGSR_ISA {

#if defined(MGSR_ISA_avx512)
constexpr int kWidth = 16;
#elif defined(MGSR_ISA_avx2)
constexpr int kWidth = 8;
#else
constexpr int kWidth = 4;
#endif

typedef float vfloat __attribute__((vector_size(kWidth * 4)));
typedef int32_t vint __attribute__((vector_size(kWidth * 4)));
typedef double vdouble __attribute__((vector_size(kWidth * 4)));

inline vfloat splat(float x) { return x - vfloat{}; }

inline vfloat load(const float* p) {
  vfloat v;
  std::memcpy(&v, p, sizeof(v));
  return v;
}

inline void store(float* p, vfloat v) { std::memcpy(p, &v, sizeof(v)); }

// Returns the values at `places` of an array.
inline vfloat load_at(const float* values, vint places) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_i32gather_ps((__m512i)places, values, sizeof(float));
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_i32gather_ps(values, (__m256i)places, sizeof(float));
#else
  vfloat v;
  for (int lane = 0; lane < kWidth; ++lane) v[lane] = values[places[lane]];
  return v;
#endif
}

inline vfloat select(vint mask, vfloat a, vfloat b) { return mask ? a : b; }
// The processor's minimum and maximum instructions, since compilers don't recognise them in a < b ? a : b. A NaN in a
// gives b.
inline vfloat min(vfloat a, vfloat b) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_min_ps((__m512)a, (__m512)b);
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_min_ps((__m256)a, (__m256)b);
#elif defined(__SSE2__)
  return (vfloat)_mm_min_ps((__m128)a, (__m128)b);
#else
  return a < b ? a : b;
#endif
}

inline vfloat max(vfloat a, vfloat b) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_max_ps((__m512)a, (__m512)b);
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_max_ps((__m256)a, (__m256)b);
#elif defined(__SSE2__)
  return (vfloat)_mm_max_ps((__m128)a, (__m128)b);
#else
  return a > b ? a : b;
#endif
}

inline vfloat abs(vfloat x) { return (vfloat)((vint)x & INT32_MAX); }

inline vfloat sqrt(vfloat x) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_sqrt_ps((__m512)x);
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_sqrt_ps((__m256)x);
#else
  for (int lane = 0; lane < kWidth; ++lane) x[lane] = __builtin_sqrtf(x[lane]);
  return x;
#endif
}

inline vdouble sqrt(vdouble x) {
#if defined(MGSR_ISA_avx512)
  return (vdouble)_mm512_sqrt_pd((__m512d)x);
#elif defined(MGSR_ISA_avx2)
  return (vdouble)_mm256_sqrt_pd((__m256d)x);
#else
  for (int lane = 0; lane < kWidth / 2; ++lane) x[lane] = __builtin_sqrt(x[lane]);
  return x;
#endif
}

// Returns a * b + c, rounded once if the variant has such an instruction. It is explicit where forward and backward
// must agree to the bit, since compilers may contract a plain product and sum in one place but not in another.
inline vfloat fma(vfloat a, vfloat b, vfloat c) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c);
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c);
#else
  return a * b + c;
#endif
}

// Returns a where the mask is set, else 0.
inline vfloat keep(vint mask, vfloat a) { return (vfloat)((vint)a & mask); }

inline bool any(vint mask) {
#if defined(MGSR_ISA_avx512)
  return _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask) != 0;
#elif defined(MGSR_ISA_avx2)
  return _mm256_movemask_ps((__m256)mask) != 0;
#elif defined(__SSE2__)
  return _mm_movemask_ps((__m128)mask) != 0;
#else
  int32_t bits = 0;
  for (int i = 0; i < kWidth; ++i) bits |= mask[i];
  return bits != 0;
#endif
}

// Writes first + lane for every lane whose mask is set, in order, and returns their number. It may write up to
// out[kWidth - 1].
inline int pack_lanes(vint mask, uint32_t first, uint32_t* out) {
#if defined(MGSR_ISA_avx512)
  const __m512i lanes = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const __mmask16 set = _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask);
  _mm512_storeu_si512(out, _mm512_maskz_compress_epi32(set, _mm512_add_epi32(lanes, _mm512_set1_epi32(int(first)))));
  return __builtin_popcount(set);
#elif defined(MGSR_ISA_avx2)
  const uint32_t set = _mm256_movemask_ps((__m256)mask);
  const uint64_t bytes = _pdep_u64(set, 0x0101010101010101u) * 0xff;  // 0xff for each lane that is set
  const __m128i lanes = _mm_cvtsi64_si128(int64_t(_pext_u64(0x0706050403020100u, bytes)));
  _mm256_storeu_si256((__m256i*)out, _mm256_add_epi32(_mm256_cvtepu8_epi32(lanes), _mm256_set1_epi32(int(first))));
  return __builtin_popcount(set);
#else
  int n = 0;
  for (int lane = 0; lane < kWidth; ++lane) {
    out[n] = first + lane;  // overwritten by the next one unless it counts
    n += mask[lane] & 1;
  }
  return n;
#endif
}

inline float sum(vfloat v) {
  float s[kWidth];
  store(s, v);
  for (int half = kWidth / 2; half > 0; half /= 2)
    for (int i = 0; i < half; ++i) s[i] += s[i + half];
  return s[0];
}

inline double sum_floats(const float* values, int n) {
  vfloat lanes = {};
  int i = 0;
  for (; i + kWidth <= n; i += kWidth) lanes += load(values + i);
  double total = sum(lanes);
  for (; i < n; ++i) total += values[i];
  return total;
}

// Adds the sum of the lanes of v[k] to sums[k], for Count vectors. `sums` must have room for Count rounded up to 4, and
// the padding is unspecified. Lanes are added in a fixed tree.
template <int Count>
inline void add_sums(const vfloat* v, float* sums) {
#if defined(MGSR_ISA_avx2) || defined(MGSR_ISA_avx512)
  for (int k = 0; k < Count; k += 4) {
    __m256 h[4];
    for (int j = 0; j < 4; ++j) {
      const vfloat x = k + j < Count ? v[k + j] : vfloat{};
#if defined(MGSR_ISA_avx512)
      h[j] = _mm256_add_ps(_mm512_castps512_ps256((__m512)x), _mm512_extractf32x8_ps((__m512)x, 1));
#else
      h[j] = (__m256)x;
#endif
    }
    const __m256 s = _mm256_hadd_ps(_mm256_hadd_ps(h[0], h[1]), _mm256_hadd_ps(h[2], h[3]));
    const __m128 four = _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1));
    _mm_storeu_ps(sums + k, _mm_add_ps(_mm_loadu_ps(sums + k), four));
  }
#else
  for (int k = 0; k < Count; ++k) sums[k] += sum(v[k]);
#endif
}

// Returns 1 / x, exact but for the last two bits.
inline vfloat reciprocal(vfloat x) {
#if defined(MGSR_ISA_avx512)
  const vfloat r = (vfloat)_mm512_rcp14_ps((__m512)x);
  return r * fma(-x, r, splat(2.0f));
#elif defined(MGSR_ISA_avx2)
  const vfloat r = (vfloat)_mm256_rcp_ps((__m256)x);
  return r * fma(-x, r, splat(2.0f));
#else
  return 1.0f / x;
#endif
}

// Replaces Count vectors x by 2^x with a relative error of 1e-7, by a polynomial of degree 5, fitted on +-0.5. Requires
// -126 <= x < 127. Several vectors are interleaved step by step, because a single one would wait for each of its steps.
template <int Count>
inline void exp2_in_range(vfloat x[Count]) {
  const vfloat shifter = splat(12582912.0f);  // 1.5 * 2^23: adding it rounds to the nearest integer
  constexpr float kTerms[] = {9.6755410e-3f, 5.5507131e-2f, 2.4022120e-1f, 6.9314694e-1f, 1.0000001f};
  vfloat shifted[Count], p[Count];
  for (int i = 0; i < Count; ++i) shifted[i] = x[i] + shifter;
  for (int i = 0; i < Count; ++i) x[i] = x[i] - (shifted[i] - shifter), p[i] = splat(1.3276479e-3f);
  for (float term : kTerms)
    for (int i = 0; i < Count; ++i) p[i] = fma(p[i], x[i], splat(term));
  // The low bits of `shifted` hold the rounded integer n; moved into the exponent field, they scale by 2^n.
  for (int i = 0; i < Count; ++i) x[i] = (vfloat)((vint)p[i] + ((vint)shifted[i] << 23));
}

inline vfloat exp2_in_range(vfloat x) {
  exp2_in_range<1>(&x);
  return x;
}

// Returns 2^x for x <= 0, and 0 for x under -126.
inline vfloat exp2_nonpositive(vfloat x) { return keep(x > splat(-126.0f), exp2_in_range(max(x, splat(-126.0f)))); }

inline bool all_finite(const float* values, int n) {
  float zero = 0;
  for (int i = 0; i < n; ++i) zero += values[i] * 0.0f;
  return zero == 0.0f;
}

// Swaps, in each square of 2 Half x 2 Half, the upper right quarter with the lower left one.
template <int Half, int... Lane>
inline void swap_quarters(vfloat& upper, vfloat& lower, std::integer_sequence<int, Lane...>) {
  const vfloat a = upper, b = lower;
  upper = __builtin_shufflevector(a, b, (Lane & Half ? Lane - Half + kWidth : Lane)...);
  lower = __builtin_shufflevector(a, b, (Lane & Half ? Lane + kWidth : Lane + Half)...);
}

// Transposes a square matrix of kWidth rows.
template <int Half = kWidth / 2>
inline void transpose(vfloat rows[kWidth]) {
  if constexpr (Half > 0) {
    for (int i = 0; i < kWidth; ++i)
      if (!(i & Half)) swap_quarters<Half>(rows[i], rows[i + Half], std::make_integer_sequence<int, kWidth>());
    transpose<Half / 2>(rows);
  }
}

}  // namespace MGSR_ISA
}  // namespace mgsr
