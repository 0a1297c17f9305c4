use super::traverse::{self, Kernels, Probe, Target};
use super::triangle::{self, Packet, PacketHits, Shear};
use super::wide::{Node, WIDTH};
use crate::{Hit, Ray};

/// What to do with a batch of rays.
pub(super) enum Query<'a> {
    Nearest(&'a [Ray], &'a mut [Hit]),
    Occluded(&'a [Ray], &'a mut [bool]),
}

/// Answers a query with the widest instructions that the processor has. Both paths do the same operations, without fused
/// operations and approximate reciprocals: their results are the same bits.
pub(super) fn run(target: Target<'_>, query: Query<'_>) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        #[allow(unsafe_code, reason = "the one call into code that needs a feature of the processor")]
        // SAFETY: the line above has found the feature.
        unsafe {
            run_avx2(target, query);
        }
        return;
    }
    run_portable(target, query);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2(target: Target<'_>, query: Query<'_>) {
    let kernels = Kernels {
        enter: |node: &Node, probe: &Probe, t_end| traverse::enter_avx2(node, probe, t_end),
        test: |packet: &Packet, shear: &Shear, t_end| triangle::test_packet_avx2(packet, shear, t_end),
    };
    answer(&kernels, target, query);
}

pub(super) fn run_portable(target: Target<'_>, query: Query<'_>) {
    answer(&Kernels { enter: traverse::enter, test: triangle::test_packet }, target, query);
}

#[inline(always)]
fn answer<E, T>(kernels: &Kernels<E, T>, target: Target<'_>, query: Query<'_>)
where
    E: Fn(&Node, &Probe, f32) -> (u32, [f32; WIDTH]),
    T: Fn(&Packet, &Shear, f32) -> PacketHits,
{
    match query {
        Query::Nearest(rays, hits) => traverse::trace::<false, E, T>(kernels, target, rays, |i, hit| hits[i] = hit),
        Query::Occluded(rays, occluded) => {
            traverse::trace::<true, E, T>(kernels, target, rays, |i, hit| occluded[i] = !hit.is_miss());
        }
    }
}
