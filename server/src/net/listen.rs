//! Parses listening addresses as users write them.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs as _};
use std::str::FromStr;

use anyhow::{Context as _, Result};
use tokio::net::TcpListener;

/// One or more addresses of one port, as `127.0.0.1:8080`, `[::1]:8080` or `localhost:8080`; `:8080`
/// means every address of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listen(Vec<SocketAddr>);

impl From<SocketAddr> for Listen {
    fn from(address: SocketAddr) -> Self {
        Self(vec![address])
    }
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = |got: &str| {
            format!("expected ADDRESS:PORT, as 127.0.0.1:8080 or localhost:8080, got {got}")
        };
        let quoted = format!("{text:?}");
        let (host, port) = text.rsplit_once(':').ok_or_else(|| expected(&quoted))?;
        let port: u16 = port.parse().map_err(|_| expected(&quoted))?;
        let mut addresses: Vec<SocketAddr> = if host.is_empty() {
            vec![
                (Ipv4Addr::UNSPECIFIED, port).into(),
                (Ipv6Addr::UNSPECIFIED, port).into(),
            ]
        } else if host.eq_ignore_ascii_case("localhost") {
            // Not left to the resolver: RFC 6761 fixes the addresses of `localhost`.
            vec![
                (Ipv4Addr::LOCALHOST, port).into(),
                (Ipv6Addr::LOCALHOST, port).into(),
            ]
        } else if host.contains(':') && !host.starts_with('[') {
            let hint = format!("{quoted}; an IPv6 address needs brackets, as [::1]:8080");
            return Err(expected(&hint));
        } else {
            let found = text.to_socket_addrs();
            found
                .map_err(|error| {
                    format!("{host}: expected a name or address of this machine: {error}")
                })?
                .collect()
        };
        // The first address is printed; IPv4 works everywhere.
        addresses.sort_by_key(SocketAddr::is_ipv6);
        addresses.dedup();
        match addresses.is_empty() {
            true => Err(expected(&quoted)),
            false => Ok(Self(addresses)),
        }
    }
}

impl std::fmt::Display for Listen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.first())
    }
}

impl Listen {
    /// The address that is printed.
    pub fn first(&self) -> SocketAddr {
        // Never empty: both constructors ensure it.
        self.0
            .first()
            .copied()
            .unwrap_or_else(|| (Ipv4Addr::LOCALHOST, 0).into())
    }

    /// Whether all addresses are loopback addresses, which other machines cannot reach.
    pub fn is_loopback(&self) -> bool {
        self.0.iter().all(|address| address.ip().is_loopback())
    }

    /// Whether `ip` is one of the addresses.
    pub(super) fn contains(&self, ip: std::net::IpAddr) -> bool {
        self.0.iter().any(|address| address.ip() == ip)
    }

    /// Binds the addresses. The first must be free; others that this machine does not have are left out with a
    /// log line. Port 0 takes one free port for all.
    pub(super) async fn bind(&self) -> Result<Vec<TcpListener>> {
        let first = self.first();
        let listener = TcpListener::bind(first)
            .await
            .with_context(|| format!("listen {first}"))?;
        let port = listener.local_addr()?.port();
        let mut listeners = vec![listener];
        for address in self.0.iter().skip(1) {
            let address = SocketAddr::new(address.ip(), port);
            match TcpListener::bind(address).await {
                Ok(listener) => listeners.push(listener),
                // On most systems `[::]` accepts IPv4 as well, and then `0.0.0.0` is already taken.
                Err(error) => tracing::debug!(%address, %error, "not listening"),
            }
        }
        Ok(listeners)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_taken_as_people_write_them() {
        let listen = |text: &str| text.parse::<Listen>();
        let addresses = |text: &str| listen(text).unwrap().0;
        let parsed = |texts: &[&str]| -> Vec<SocketAddr> {
            texts.iter().map(|text| text.parse().unwrap()).collect()
        };
        assert_eq!(addresses("127.0.0.1:80"), parsed(&["127.0.0.1:80"]));
        assert_eq!(addresses("[::1]:80"), parsed(&["[::1]:80"]));
        let local = parsed(&["127.0.0.1:80", "[::1]:80"]);
        assert_eq!(addresses("localhost:80"), local);
        assert_eq!(addresses("LOCALHOST:80"), local);
        assert!(listen("localhost:0").unwrap().is_loopback());
        assert_eq!(addresses(":80"), parsed(&["0.0.0.0:80", "[::]:80"]));
        assert!(!listen(":80").unwrap().is_loopback());
        for (text, named) in [
            ("8080", "ADDRESS:PORT"),
            ("localhost", "ADDRESS:PORT"),
            ("localhost:", "ADDRESS:PORT"),
            ("localhost:99999", "ADDRESS:PORT"),
            ("::1:8080", "brackets"),
            ("no such name:8080", "no such name"),
        ] {
            let hint = listen(text).unwrap_err();
            assert!(hint.contains(named), "{text}: {hint}");
        }
    }
}
