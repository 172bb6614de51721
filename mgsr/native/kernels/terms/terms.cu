// The loss terms on the GPU outside the image family. The headers describe the kernels.
#include "kernels/terms/images_cuda.h"
#include "kernels/terms/totals_cuda.h"

MGSR_KERNEL(terms_target, mgsr::TargetParams, mgsr::kTermThreads) { mgsr::composite(p); }
MGSR_KERNEL(terms_covered, mgsr::CoveredParams, mgsr::kTermThreads) { mgsr::find_covered(p); }
MGSR_KERNEL(terms_silhouette, mgsr::SilhouetteParams, mgsr::kTermThreads) { mgsr::compare_silhouettes(p); }
MGSR_KERNEL(terms_squares, mgsr::SquaresParams, mgsr::kTermThreads) { mgsr::sum_squares(p); }
MGSR_KERNEL(terms_product, mgsr::ProductParams, mgsr::kTermThreads) { mgsr::sum_products(p); }
MGSR_KERNEL(terms_steps, mgsr::StepsParams, mgsr::kTermThreads) { mgsr::sum_steps(p); }
MGSR_KERNEL(terms_totals, mgsr::TotalsParams, mgsr::kTotalThreads) { mgsr::find_value(p); }
MGSR_KERNEL(terms_gradients, mgsr::GradientsParams, mgsr::kGradientThreads) { mgsr::add_up_gradients(p); }
