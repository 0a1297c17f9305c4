//! hplt-basis
