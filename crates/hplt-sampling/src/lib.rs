//! hplt-sampling
