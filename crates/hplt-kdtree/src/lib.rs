//! hplt-kdtree
