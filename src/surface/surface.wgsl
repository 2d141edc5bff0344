// Twin of `surface`: a hit with everything that scattering there needs, and coverage.

// Words of a shape: material, coverage (its channel or NONE, its value or program), flags.
const SHAPE: u32 = 4u;
const SHAPE_COVERAGE: u32 = 1u;
const SHAPE_ANISOTROPIC: u32 = 2u;
const SHAPE_ONE_SIDED: u32 = 4u;

struct SurfacePoint {
    position: vec3f,
    error: vec3f,
    geometric_normal: vec3f,
    frame: Frame,
    bsdf: Bsdf,
}

fn surface_at(w: u32, hit: Hit, point: HitPoint) -> SurfacePoint {
    let shape = inputs.worlds[w].shapes + point.shape * SHAPE;
    var frame: Frame;
    //#if ANISOTROPIC
    if ANISOTROPIC && (words[shape + 3u] & SHAPE_ANISOTROPIC) != 0u {
        frame = frame_from_normal_and_tangent(point.shading_normal, tangent_at(w, hit, point.geometric_normal));
    } else {
        frame = frame_from_normal(point.shading_normal);
    }
    //#else
    frame = frame_from_normal(point.shading_normal);
    //#endif
    return SurfacePoint(
        point.position,
        point.error,
        point.geometric_normal,
        frame,
        material_at(words[shape], point.uv),
    );
}

// Where a ray towards `direction` starts, off the surface on the side that it leaves to.
fn surface_origin(surface: SurfacePoint, direction: vec3f) -> vec3f {
    let side = copysign(1.0, dot3(direction, surface.geometric_normal));
    return offset_origin(surface.position, surface.geometric_normal * side, surface.error);
}

// Whether a hit stops a ray: a coin that is a hash of both.
fn covers(w: u32, ray: Ray, hit: Hit) -> bool {
    let point = shape_of(w, hit);
    let shape = inputs.worlds[w].shapes + point.x * SHAPE;
    if (words[shape + 3u] & SHAPE_COVERAGE) == 0u {
        return true;
    }
    let alpha = scalar_at(shape + 1u, point_at(w, hit).uv);
    if alpha >= 1.0 {
        return true;
    }
    if alpha <= 0.0 {
        return false;
    }
    let d = bitcast<vec3<u32>>(ray.direction);
    let word = pcg4d(vec4<u32>(
        d.x ^ bitcast<u32>(ray.origin.x),
        d.y ^ bitcast<u32>(ray.origin.y),
        d.z,
        bitcast<u32>(hit.t) ^ hit.primitive,
    )).x;
    return unit_float(word) < alpha;
}

//#if ONE_SIDED_SHAPES
// Whether a ray meets the back of a one-sided surface.
fn is_hidden_back(w: u32, ray: Ray, hit: Hit) -> bool {
    let shape = inputs.worlds[w].shapes + shape_of(w, hit).x * SHAPE;
    return (words[shape + 3u] & SHAPE_ONE_SIDED) != 0u
        && dot3(ray.direction, point_at(w, hit).geometric_normal) > 0.0;
}
//#endif

// The nearest surface that is seen along a ray from the camera, which passes the backs of one-sided
// surfaces.
fn camera_hit(w: u32, ray: Ray) -> Hit {
    //#if ONE_SIDED_SHAPES
    let hit = closest_hit(w, ray);
    if ONE_SIDED_SHAPES && hit.primitive != MISS && is_hidden_back(w, ray, hit) {
        passes_backs = true;
        let behind = closest_hit(w, ray);
        passes_backs = false;
        return behind;
    }
    return hit;
    //#else
    return closest_hit(w, ray);
    //#endif
}
