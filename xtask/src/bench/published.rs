//! What was published in 2010: M. Zollhöfer, Hierarchical Point Based Light Transport, FAU Erlangen, 26.11.2010.
//!
//! Neither the rays per gather nor the machine nor the error were published.

/// All published figures of one scene.
pub struct Published {
    /// Its scene.
    pub scene: &'static str,
    /// Primitives.
    pub primitives: &'static str,
    /// Levels of the hierarchy.
    pub levels: &'static str,
    /// Levels that senders are read from.
    pub sender_levels: &'static str,
    /// Threshold of refinement.
    pub threshold: &'static str,
    /// Functions on the coarsest and on the finest level.
    pub functions: &'static str,
    /// The original variant on a CPU.
    pub v1_cpu: Timing,
    /// The original variant on a GPU.
    pub v2_gpu: Timing,
    /// The optimised variant on a GPU.
    pub v3_gpu: Timing,
}

/// One published row.
pub struct Timing {
    /// Bounces 1 / 2 / 3.
    pub bounces: &'static str,
    /// Gathers.
    pub integrals: &'static str,
    /// All of the transport.
    pub transport: &'static str,
    /// The same in seconds.
    pub transport_seconds: f64,
}

/// The Cornell box.
pub const CORNELL: Published = Published {
    scene: "Cornell",
    primitives: "36",
    levels: "6",
    sender_levels: "3",
    threshold: "0.016",
    functions: "218 / 167k",
    v1_cpu: Timing { bounces: "21 / 2.9 / 2.4 s", integrals: "13k", transport: "32 s", transport_seconds: 32.0 },
    v2_gpu: Timing { bounces: "1.2 / 0.2 / 0.15 s", integrals: "13k", transport: "1.9 s", transport_seconds: 1.9 },
    v3_gpu: Timing { bounces: "0.49 / 0.15 / 0.1 s", integrals: "14k", transport: "1.0 s", transport_seconds: 1.0 },
};

/// The Happy Buddha.
pub const HAPPY: Published = Published {
    scene: "Happy",
    primitives: "1.05M",
    levels: "6",
    sender_levels: "3",
    threshold: "0.016",
    functions: "582 / 288k",
    v1_cpu: Timing { bounces: "499 / 154 / 44 s", integrals: "67k", transport: "728 s", transport_seconds: 728.0 },
    v2_gpu: Timing { bounces: "15 / 4.1 / 1.3 s", integrals: "66k", transport: "21 s", transport_seconds: 21.0 },
    v3_gpu: Timing { bounces: "3.5 / 1.0 / 0.4 s", integrals: "68k", transport: "5.6 s", transport_seconds: 5.6 },
};

/// Sponza.
pub const SPONZA: Published = Published {
    scene: "Sponza",
    primitives: "279k",
    levels: "6",
    sender_levels: "3",
    threshold: "0.15",
    functions: "1438 / 356k",
    v1_cpu: Timing { bounces: "567 / 82 / 24 s", integrals: "37k", transport: "743 s", transport_seconds: 743.0 },
    v2_gpu: Timing { bounces: "19 / 3.0 / 1.0 s", integrals: "36k", transport: "26 s", transport_seconds: 26.0 },
    v3_gpu: Timing { bounces: "3.0 / 0.4 / 0.3 s", integrals: "37k", transport: "4.5 s", transport_seconds: 4.5 },
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_what_is_computed_with() {
        for scene in [&CORNELL, &HAPPY, &SPONZA] {
            for timing in [&scene.v1_cpu, &scene.v2_gpu, &scene.v3_gpu] {
                assert_eq!(timing.transport.trim_end_matches(" s").parse::<f64>().unwrap(), timing.transport_seconds);
            }
        }
    }
}
