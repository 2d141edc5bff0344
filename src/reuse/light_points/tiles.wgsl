// Twin of the tiles of `reuse::light_points::candidates` and `initial`: light points made ahead,
// for many lights.

// Number of tiles of light points, and the buffer that they lie in.
override LIGHT_TILES: u32 = 0u;
override B_TILES: u32 = 0u;

// Entries of a tile, words of an entry.
const TILE: u32 = 256u;
const TILE_ENTRY: u32 = 15u;
// Width and height in pixels of the blocks that share a tile.
const TILE_BLOCK: u32 = 8u;

fn write_tile_entry(item: u32, emitter: EmitterPoint, uv: vec2f, density: f32) {
    let at = buffer_now(B_TILES) + item * TILE_ENTRY;
    write_vector(at, emitter.position);
    write_vector(at + 3u, emitter.normal);
    write_vector(at + 6u, emitter.radiance);
    state[at + 9u] = emitter.kind;
    state[at + 10u] = emitter.light;
    state[at + 11u] = emitter.light;
    state[at + 12u] = bitcast<u32>(uv.x);
    state[at + 13u] = bitcast<u32>(uv.y);
    state[at + 14u] = bitcast<u32>(density);
}

fn fill_tile(item: u32, draw: vec4<u32>) {
    count(TILE_ENTRIES, 1u);
    var none: EmitterPoint;
    if inputs.worlds[NOW].alias_count == 0u {
        write_tile_entry(item, none, vec2f(0.0), 0.0);
        return;
    }
    let light = choose_light(NOW, draw.x, draw.y);
    let point = LightPoint(light, vec2f(unit_float(draw.z), unit_float(draw.w)));
    let emitter = light_emitter(NOW, point);
    let density = uniform_density(NOW, point);
    if emitter.valid && density > 0.0 {
        write_tile_entry(item, emitter, point.uv, density);
    } else {
        write_tile_entry(item, none, vec2f(0.0), 0.0);
    }
}

fn light_tiles(item: u32) {
    var random = stream_of(item, PURPOSE_LIGHT_TILE, 1u);
    let a = stream_word(&random);
    let b = stream_word(&random);
    let c = stream_word(&random);
    fill_tile(item, vec4<u32>(a, b, c, stream_word(&random)));
}

// The first word of the tile that a pixel's block shares.
fn tile_of(x: u32, y: u32) -> u32 {
    if LIGHT_TILES == 0u {
        return 0u;
    }
    let columns = (inputs.size.x + TILE_BLOCK - 1u) / TILE_BLOCK;
    let block = y / TILE_BLOCK * columns + x / TILE_BLOCK;
    var random = stream_of(block, PURPOSE_LIGHT_TILE, 0u);
    return buffer_now(B_TILES) + stream_index(&random, LIGHT_TILES) * TILE * TILE_ENTRY;
}
