// Twin of `path`: the walk from the camera.

const SAMPLE_NONE: u32 = 0u;
const SAMPLE_ONE: u32 = 1u;
const SAMPLE_ALL: u32 = 2u;

fn power_heuristic(a: f32, b: f32) -> f32 {
    let ratio = b / a;
    return 1.0 / (1.0 + ratio * ratio);
}

fn emitted(w: u32, point: HitPoint, direction: vec3f) -> vec3f {
    let light = light_of_surface(w, point.shape, point.element);
    if light == NO_LIGHT {
        return vec3f(0.0);
    }
    return light_emitted(w, light, point.uv, -dot3(direction, point.geometric_normal));
}

fn shadow_ray(surface: SurfacePoint, direction: vec3f, end: vec4f) -> Ray {
    let origin = surface_origin(surface, direction);
    if end.w != 0.0 {
        return Ray(origin, end.xyz - origin, 1.0);
    }
    return Ray(origin, direction, FAR);
}

// Light reflected or transmitted towards the camera at a primary hit. With `sampled` ALL one light
// after the other; without `direct`, what comes straight to the primary hit and leaves it by a lobe
// that is not a delta is left out.
fn walk(
    seed: vec2<u32>,
    primary_direction: vec3f,
    primary_hit: Hit,
    roulette_after: u32,
    sampled: u32,
    direct: bool,
) -> vec3f {
    var radiance = vec3f(0.0);
    var throughput = vec3f(1.0);
    var eta_scale = 1.0;
    var direction = primary_direction;
    var hit = primary_hit;
    var point = point_at(NOW, hit);
    count(PATHS, 1u);
    for (var vertex = 0u; vertex + 1u < inputs.depth; vertex++) {
        let surface = surface_at(NOW, hit, point);
        if bsdf_is_black(surface.bsdf) {
            break;
        }
        let outgoing = to_local(surface.frame, -direction);
        let lit = direct || vertex > 0u;
        if sampled != SAMPLE_NONE && lit && bsdf_has_non_delta(surface.bsdf) && inputs.worlds[NOW].alias_count > 0u {
            var first = 0u;
            var end = inputs.worlds[NOW].light_count;
            var draw = vec4<u32>(0u);
            if sampled == SAMPLE_ONE {
                draw = draw4(seed, vertex, BLOCK_LIGHT);
                first = choose_light(NOW, draw.x, draw.y);
                end = first + 1u;
            }
            for (var light = first; light < end; light++) {
                var choice = choice_probability(NOW, light);
                var u = vec2f(unit_float(draw.z), unit_float(draw.w));
                if sampled == SAMPLE_ALL {
                    if !(choice > 0.0) {
                        continue;
                    }
                    choice = 1.0;
                    let own = draw4(seed, vertex, BLOCK_LIGHTS | light);
                    u = vec2f(unit_float(own.x), unit_float(own.y));
                }
                radiance += throughput * direct_light(surface, outgoing, light, choice, u);
            }
        }
        let scattered = bsdf_sample(surface.bsdf, outgoing, draw4(seed, vertex, BLOCK_SCATTER));
        if !scattered.valid {
            break;
        }
        let last = vertex + 2u == inputs.depth;
        let counted = lit || scattered.delta;
        if last && !counted {
            break;
        }
        throughput *= scattered.value / scattered.pdf;
        if scattered.transmission {
            eta_scale *= scattered.eta * scattered.eta;
        }
        if all_zero(throughput) {
            break;
        }
        if vertex >= roulette_after {
            let survival = min(max3(throughput) * eta_scale, 0.95);
            if unit_float(draw4(seed, vertex, BLOCK_ROULETTE).x) >= survival {
                break;
            }
            throughput /= survival;
        }
        direction = unit(to_world(surface.frame, scattered.wi));
        count(BOUNCE_RAYS, 1u);
        let next = closest_hit(NOW, Ray(surface_origin(surface, direction), direction, FAR));
        if next.primitive == MISS {
            //#if ENVIRONMENTS
            if ENVIRONMENTS && counted {
                for (var i = 0u; i < inputs.worlds[NOW].environment_count; i++) {
                    let environment = environment_number(NOW, i);
                    let pdf = environment_pdf(environment, direction);
                    let share = bsdf_share(scattered, environment_light(environment), pdf, sampled);
                    radiance += throughput * environment_radiance(environment, direction) * share;
                }
            }
            //#endif
            break;
        }
        let shape = shape_of(NOW, next);
        let light = light_of_surface(NOW, shape.x, shape.y);
        if last && light == NO_LIGHT {
            break;
        }
        hit = next;
        point = point_at(NOW, next);
        if light != NO_LIGHT && counted {
            let cos_light = -dot3(direction, point.geometric_normal);
            let emission = light_emitted(NOW, light, point.uv, cos_light);
            if !all_zero(emission) {
                let pdf = light_pdf_towards(NOW, light, surface.position, point.position, cos_light);
                radiance += throughput * emission * bsdf_share(scattered, light, pdf, sampled);
            }
        }
    }
    return radiance;
}

// The share of a direction that BSDF sampling found, where light sampling has `pdf` given the
// light.
fn bsdf_share(scattered: BsdfSample, light: u32, pdf: f32, sampled: u32) -> f32 {
    if scattered.delta || sampled == SAMPLE_NONE {
        return 1.0;
    }
    return power_heuristic(scattered.pdf, select(pdf, choice_probability(NOW, light) * pdf, sampled == SAMPLE_ONE));
}

fn direct_light(surface: SurfacePoint, outgoing: vec3f, light: u32, choice: f32, u: vec2f) -> vec3f {
    let incident = light_sample_towards(NOW, light, surface.position, u);
    if !incident.valid {
        count(SHADOW_RAYS_SAVED, 1u);
        return vec3f(0.0);
    }
    let scattered = bsdf_evaluate(surface.bsdf, outgoing, to_local(surface.frame, incident.direction));
    if all_zero(scattered.value) {
        count(SHADOW_RAYS_SAVED, 1u);
        return vec3f(0.0);
    }
    count(SHADOW_RAYS, 1u);
    let end = shadow_end(NOW, incident.emitter, surface.position);
    if occluded(NOW, shadow_ray(surface, incident.direction, end)) {
        return vec3f(0.0);
    }
    let density = choice * incident.pdf;
    var share = 1.0;
    if !incident.delta {
        share = power_heuristic(density, scattered.pdf);
    }
    return incident.radiance * scattered.value * (share / density);
}
