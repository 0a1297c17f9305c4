//! What this benchmark needs of Embree's C interface, loaded at run time: versions 3 and 4 differ only in where the last
//! two arguments of the tracing functions stand.

use std::ffi::c_void;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use hplt_geom::{Hit, Mesh, Ray, TriangleId};
use libloading::{Library, Symbol};

type Handle = *mut c_void;
type Trace = unsafe extern "C" fn(*const c_void, *mut c_void, *mut c_void);
type TracePacket = unsafe extern "C" fn(*const i32, *const c_void, *mut c_void, *mut c_void);

const INVALID: u32 = u32::MAX;
const TRIANGLES: u32 = 0;
const INDEX_BUFFER: u32 = 0;
const VERTEX_BUFFER: u32 = 1;
const UINT3: u32 = 0x5003;
const FLOAT3: u32 = 0x9003;
const ROBUST: u32 = 1 << 2;
const HIGH_QUALITY: u32 = 2;
const VERSION_MAJOR: u32 = 1;

/// `N` rays and their hits, in the order of `RTCRayHitN`. Embree 3 lacks the last field.
#[repr(C, align(64))]
struct Packet<const N: usize> {
    origin: [[f32; N]; 3],
    t_near: [f32; N],
    direction: [[f32; N]; 3],
    time: [f32; N],
    t_far: [f32; N],
    mask: [u32; N],
    id: [u32; N],
    flags: [u32; N],
    normal: [[f32; N]; 3],
    u: [f32; N],
    v: [f32; N],
    primitive: [u32; N],
    geometry: [u32; N],
    instance: [u32; N],
    instance_primitive: [u32; N],
}

impl<const N: usize> Packet<N> {
    fn new(rays: &[Ray]) -> Self {
        let row = |f: &dyn Fn(&Ray) -> f32| std::array::from_fn(|i| f(&rays[i.min(rays.len() - 1)]));
        let rows = |f: &dyn Fn(&Ray) -> [f32; 3]| std::array::from_fn(|axis| row(&|ray| f(ray)[axis]));
        Self {
            origin: rows(&|ray| ray.origin.to_array()),
            t_near: [0.0; N],
            direction: rows(&|ray| ray.direction.to_array()),
            time: [0.0; N],
            t_far: row(&|ray| ray.t_max),
            mask: [u32::MAX; N],
            id: [0; N],
            flags: [0; N],
            normal: [[0.0; N]; 3],
            u: [0.0; N],
            v: [0.0; N],
            primitive: [INVALID; N],
            geometry: [INVALID; N],
            instance: [INVALID; N],
            instance_primitive: [INVALID; N],
        }
    }

    fn hit(&self, lane: usize) -> Hit {
        if self.geometry[lane] == INVALID {
            return Hit::MISS;
        }
        let along: f32 = (0..3).map(|axis| self.normal[axis][lane] * self.direction[axis][lane]).sum();
        Hit {
            t: self.t_far[lane],
            u: self.u[lane],
            v: self.v[lane],
            triangle: TriangleId(self.primitive[lane]),
            is_front: along < 0.0,
        }
    }
}

/// Version 3's context of a query: incoherent, without a filter.
#[repr(C)]
struct Context3 {
    flags: u32,
    filter: Handle,
    instance: [u32; 4],
}

/// How rays are handed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    One,
    Eight,
    Sixteen,
}

/// The functions of one loaded library.
pub struct Embree {
    library: Library,
    device: Handle,
    version: isize,
}

/// A scene of one mesh, committed.
pub struct EmbreeScene<'a> {
    embree: &'a Embree,
    scene: Handle,
    intersect: [*const c_void; 3],
    occluded: [*const c_void; 3],
}

// SAFETY: tracing a committed scene is thread-safe by Embree's documentation; nothing else is called after `build`.
unsafe impl Sync for EmbreeScene<'_> {}

impl Embree {
    /// The library at `path`, with `threads` building threads.
    pub fn load(path: &Path, threads: usize) -> Result<Self> {
        // SAFETY: the caller names an Embree library; its initialisers have no other preconditions.
        let library = unsafe { Library::new(path) }.with_context(|| format!("{} cannot be loaded", path.display()))?;
        let mut embree = Self { library, device: std::ptr::null_mut(), version: 0 };
        let config = std::ffi::CString::new(format!("threads={threads}"))?;
        // SAFETY: the signatures are those of rtcore_device.h.
        unsafe {
            let new: Symbol<'_, unsafe extern "C" fn(*const i8) -> Handle> = embree.library.get(b"rtcNewDevice\0")?;
            let device = new(config.as_ptr().cast());
            ensure!(!device.is_null(), "Embree makes no device");
            let property: Symbol<'_, unsafe extern "C" fn(Handle, u32) -> isize> =
                embree.library.get(b"rtcGetDeviceProperty\0")?;
            let version = [VERSION_MAJOR, 2, 3].map(|part| property(device, part));
            println!("Embree {}.{}.{}, {}", version[0], version[1], version[2], path.display());
            (embree.device, embree.version) = (device, version[0]);
        }
        ensure!([3, 4].contains(&embree.version), "versions 3 and 4 of Embree are known");
        Ok(embree)
    }

    /// The committed scene of all triangles of `mesh`: high quality, two-sided, robust where asked for.
    pub fn build(&self, mesh: &Mesh, robust: bool) -> Result<EmbreeScene<'_>> {
        // SAFETY: the signatures are those of rtcore_scene.h and rtcore_geometry.h; Embree owns the buffers and pads them.
        unsafe {
            let get = |name: &[u8]| self.library.get::<*const c_void>(name).map(|symbol| *symbol);
            let new_scene: unsafe extern "C" fn(Handle) -> Handle = std::mem::transmute(get(b"rtcNewScene\0")?);
            let set: unsafe extern "C" fn(Handle, u32) = std::mem::transmute(get(b"rtcSetSceneFlags\0")?);
            let quality: unsafe extern "C" fn(Handle, u32) = std::mem::transmute(get(b"rtcSetSceneBuildQuality\0")?);
            let new_geometry: unsafe extern "C" fn(Handle, u32) -> Handle =
                std::mem::transmute(get(b"rtcNewGeometry\0")?);
            let new_buffer: unsafe extern "C" fn(Handle, u32, u32, u32, usize, usize) -> Handle =
                std::mem::transmute(get(b"rtcSetNewGeometryBuffer\0")?);
            let attach: unsafe extern "C" fn(Handle, Handle) -> u32 = std::mem::transmute(get(b"rtcAttachGeometry\0")?);
            let commit_geometry: unsafe extern "C" fn(Handle) = std::mem::transmute(get(b"rtcCommitGeometry\0")?);
            let commit_scene: unsafe extern "C" fn(Handle) = std::mem::transmute(get(b"rtcCommitScene\0")?);

            let scene = new_scene(self.device);
            set(scene, if robust { ROBUST } else { 0 });
            quality(scene, HIGH_QUALITY);
            let geometry = new_geometry(self.device, TRIANGLES);
            let positions = mesh.positions();
            let vertices = new_buffer(geometry, VERTEX_BUFFER, 0, FLOAT3, 12, positions.len());
            let indices = new_buffer(geometry, INDEX_BUFFER, 0, UINT3, 12, mesh.n_triangles());
            ensure!(!vertices.is_null() && !indices.is_null(), "Embree makes no buffer");
            std::ptr::copy_nonoverlapping(positions.as_ptr().cast::<f32>(), vertices.cast(), 3 * positions.len());
            std::ptr::copy_nonoverlapping(mesh.triangles().as_ptr(), indices.cast(), mesh.n_triangles());
            commit_geometry(geometry);
            attach(scene, geometry);
            commit_scene(scene);
            Ok(EmbreeScene {
                embree: self,
                scene,
                intersect: [get(b"rtcIntersect1\0")?, get(b"rtcIntersect8\0")?, get(b"rtcIntersect16\0")?],
                occluded: [get(b"rtcOccluded1\0")?, get(b"rtcOccluded8\0")?, get(b"rtcOccluded16\0")?],
            })
        }
    }
}

impl EmbreeScene<'_> {
    /// As `RayCaster::trace_nearest`.
    pub fn trace_nearest(&self, width: Width, rays: &[Ray], hits: &mut [Hit]) {
        match width {
            Width::One => self.each::<1>(self.intersect[0], rays, |i, p, lane| hits[i] = p.hit(lane)),
            Width::Eight => self.each::<8>(self.intersect[1], rays, |i, p, lane| hits[i] = p.hit(lane)),
            Width::Sixteen => self.each::<16>(self.intersect[2], rays, |i, p, lane| hits[i] = p.hit(lane)),
        }
    }

    /// As `RayCaster::trace_occluded`.
    pub fn trace_occluded(&self, width: Width, rays: &[Ray], occluded: &mut [bool]) {
        // Embree marks a ray that is blocked with an infinite negative distance.
        match width {
            Width::One => self.each::<1>(self.occluded[0], rays, |i, p, lane| occluded[i] = p.t_far[lane] < 0.0),
            Width::Eight => self.each::<8>(self.occluded[1], rays, |i, p, lane| occluded[i] = p.t_far[lane] < 0.0),
            Width::Sixteen => self.each::<16>(self.occluded[2], rays, |i, p, lane| occluded[i] = p.t_far[lane] < 0.0),
        }
    }

    #[inline(always)]
    fn each<const N: usize>(&self, trace: *const c_void, rays: &[Ray], mut take: impl FnMut(usize, &Packet<N>, usize)) {
        let mut context = Context3 { flags: 0, filter: std::ptr::null_mut(), instance: [INVALID; 4] };
        let context = (&raw mut context).cast::<c_void>();
        for (chunk, rays) in rays.chunks(N).enumerate() {
            let mut packet = Packet::<N>::new(rays);
            let valid: [i32; N] = std::array::from_fn(|i| if i < rays.len() { -1 } else { 0 });
            let packet_pointer = (&raw mut packet).cast::<c_void>();
            // Version 4 takes optional arguments after the rays, version 3 a context before them.
            let (second, third) = if self.embree.version == 3 {
                (context, packet_pointer)
            } else {
                (packet_pointer, std::ptr::null_mut())
            };
            // SAFETY: the pointers are to a packet of the width that the function takes.
            unsafe {
                if N == 1 {
                    std::mem::transmute::<*const c_void, Trace>(trace)(self.scene, second, third);
                } else {
                    let trace = std::mem::transmute::<*const c_void, TracePacket>(trace);
                    trace(valid.as_ptr(), self.scene, second, third);
                }
            }
            for lane in 0..rays.len() {
                take(chunk * N + lane, &packet, lane);
            }
        }
    }
}
